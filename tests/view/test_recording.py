import dataclasses

import numpy as np
import pytest
from rerun.chunk import RrdReader

from tests.view.viewer import NoDriver, look
from workcell.errors import TraceError
from workcell.trace.table import load
from workcell.trace.writer import TraceWriter
from workcell.view import recording as view
from workcell.view import viewer
from workcell.view.blueprint import VIEW_NAMES
from workcell.view.limits import DANGER_MARGIN
from workcell.view.palette import DANGER


@pytest.fixture(scope="module")
def recording(run, tmp_path_factory):
    return view.record(run.trace, run.scene, tmp_path_factory.mktemp("view") / "recording.rrd")


@pytest.fixture(scope="module")
def content(recording):
    """Component columns by entity and name, flattened."""
    found = {}
    for chunk in RrdReader(str(recording)).stream():
        batch = chunk.to_record_batch()
        for field, column in zip(batch.schema, batch.columns, strict=True):
            entries = found.setdefault(chunk.entity_path, {}).setdefault(field.name, [])
            entries.extend(column.to_pylist())
    return found


def test_curves_are_the_trace(run, content):
    trace = run.trace
    drawn = np.array(content["/tool_speed"]["Scalars:scalars"])
    logged = [trace["surgeon.tool_speed_m_s"], trace["nurse.tool_speed_m_s"]]
    np.testing.assert_array_equal(drawn, np.column_stack(logged))
    limit, _, measured = np.array(content["/ttc"]["Scalars:scalars"]).T
    assert set(limit) == {0.8}
    known = np.isfinite(trace["ttc_s"])
    np.testing.assert_array_equal(measured[known], np.minimum(trace["ttc_s"][known], 5 * 0.8))
    assert np.isinf(measured[~known]).all(), "nothing closes: a gap"


def test_geometry_is_drawn_fifty_times_a_second(run, content):
    poses = content["/world/nurse/capsules"]["InstancePoses3D:translations"]
    assert len(poses) == len(run.trace) / 5
    assert len(poses[0]) == 3, "three capsules an arm"
    colours = content["/world/witness"]["LineStrips3D:colors"]
    red = sum(colour[0] >> 8 == int.from_bytes(bytes(DANGER)) for colour in colours)
    danger = run.trace["ttc_s"][::5] < 0.8 * DANGER_MARGIN
    assert red == danger.sum()
    assert 0 < red < len(colours)


def test_every_change_of_mode_is_an_event(run, content):
    events = content["/events"]["TextLog:text"]
    said = [text for (text,) in events]
    assert said.count("cell: scale") == 2
    assert said.count("cell: halt") == 1
    assert "nurse: held back by halt" in said
    assert "nurse: held back by ttc (surgeon/link2_capsule and nurse/link3_capsule)" in said


def test_target_trail_and_path_ahead_are_drawn(run, content):
    trace = run.trace
    tool, target = (
        trace[f"nurse.{name}_position_m"].astype(np.float32) for name in ("tool", "target")
    )
    positions = np.array(content["/world/nurse/target"]["Points3D:positions"]).reshape(-1, 3)
    np.testing.assert_array_equal(positions, target[::5])
    every = 25  # rows of 4 ms in a tenth of a second
    for name, wanted, end in (("trail", tool, -1), ("path_ahead", target, 0)):
        strips = [strip for (strip,) in content[f"/world/nurse/{name}"]["LineStrips3D:strips"]]
        assert len(strips) == len(trace) / every
        np.testing.assert_array_equal([s[end] for s in strips], wanted[::every])
    ahead = np.array(strips[0])
    np.testing.assert_array_equal(ahead[20], target[20 * 12])


def test_the_verdict_is_in_the_recording(run, tmp_path):
    expectations = {"contact": {"wanted": "false", "measured": "true", "held": False}}
    summary = {
        "scenario": "two arms",
        "held": False,
        "expectations": expectations,
        "metrics": {"fault": None, "smallest_distance_m": 0.0123},
    }
    made = view.record(run.trace, run.scene, tmp_path / "r.rrd", summary=summary)
    store = RrdReader(str(made)).stream().filter(content="/verdict")
    (text,) = [str(chunk.to_record_batch().to_pydict()) for chunk in store]
    assert "not as expected: contact" in text
    assert "smallest distance: 0.0123 m" in text
    assert view.is_current(made, run.trace, summary=summary)
    assert not view.is_current(made, run.trace, summary=summary | {"held": True})


def test_a_recording_knows_what_it_was_made_of(run, recording, tmp_path, monkeypatch):
    assert view.is_current(recording, run.trace)
    other = dataclasses.replace(run.trace, rows=run.trace.table.slice(1))
    assert not view.is_current(recording, other)
    monkeypatch.setattr(view, "VIEW_VERSION", view.VIEW_VERSION + 1)
    assert not view.is_current(recording, run.trace)
    monkeypatch.undo()
    assert not view.is_current(tmp_path / "none.rrd", run.trace)
    cut = tmp_path / "cut.rrd"
    for kept in (0, 3000, -10):
        cut.write_bytes(recording.read_bytes()[:kept])
        assert not view.is_current(cut, run.trace)


def test_misfits_are_refused(run, tmp_path):
    scene = tmp_path / "scene.xml"
    scene.write_text("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
    with pytest.raises(TraceError, match=r"has 6 coordinates, .*scene\.xml has 0"):
        view.record(run.trace, scene, tmp_path / "r.rrd")
    with TraceWriter(tmp_path / "empty", run.trace.layout, {}, 0.01):
        pass
    with pytest.raises(TraceError, match="no rows"):
        view.record(load(tmp_path / "empty"), run.scene, tmp_path / "r.rrd")
    with pytest.raises(TraceError, match="no such recording"):
        viewer.open_viewer(tmp_path / "r.rrd")
    assert list(tmp_path.glob("r.rrd*")) == []


@pytest.mark.parametrize("web", [False, True])
def test_the_viewer_listens_to_this_machine_only(recording, monkeypatch, web):
    started = []
    monkeypatch.setattr(viewer.subprocess, "Popen", lambda command, **_: started.append(command))
    monkeypatch.setenv("DISPLAY", ":0")
    viewer.open_viewer(recording, web=web)
    command = started[0]
    assert command[command.index("--bind") + 1] == "127.0.0.1"
    assert ("--serve-web" in command) == web
    assert viewer.viewer_binary().is_file()


def test_the_viewer_shows_it(recording, tmp_path):
    try:
        sight = look(recording, tmp_path / "view.png", 1.6)
    except NoDriver as error:
        pytest.skip(f"no Vulkan driver to draw with: {error}")
    assert sight.views == set(VIEW_NAMES)
    assert sight.problems == []
    assert sight.errors == []
    assert sight.timelines >= {"sim_time", "tick"}
