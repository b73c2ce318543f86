"""The judge on whole runs: what it says of them, and that it is not told by the controller."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tests import cells
from workcell import run as runner
from workcell.cli import main
from workcell.errors import TraceError
from workcell.judge import judge_run
from workcell.judge.table import lines
from workcell.simulation.measurement import Measurement


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory):
    """A short run of two planar arms."""
    folder = tmp_path_factory.mktemp("judged")
    content = cells.duet()
    content["simulation"]["duration_s"] = 4.0
    content["check"] = {"enabled": False}
    runner.run(cells.load(folder, content), folder / "run")
    return folder / "run"


def test_an_undisturbed_run_is_seen_as_the_controller_saw_it(folder):
    """Where the belief is the truth, an independent judge finds what the trace says."""
    from workcell.trace.metrics import summarise
    from workcell.trace.table import load

    verdict, seen = judge_run(folder), summarise(load(folder))
    assert verdict.states == "plant"
    for name, value in verdict.metrics().items():
        if (
            name in ("contact_cause", "contacts_by_support", "own_short_ticks")
            or name.endswith(
                "_time_s"  # where an estimate is held at t_min, rounding says which tick is the smallest
            )
        ):
            continue
        if isinstance(value, float):
            assert value == pytest.approx(seen[name], rel=1e-6), name
        else:
            assert value == seen[name], name
    assert verdict.contact is None
    assert verdict.short_ticks == 0


def test_a_stale_belief_does_not_hide_a_contact(tmp_path, monkeypatch):
    """The controller sees its first state for ever; its links overlap, and judge and summary say so."""
    seen = {}

    def stale(self, qpos, qvel):
        return seen.setdefault(id(self), (np.array(qpos), np.array(qvel)))

    monkeypatch.setattr(Measurement, "read", stale)
    content = cells.duet()
    content["simulation"]["duration_s"] = 7.0
    content["check"] = {"enabled": False}
    summary = runner.run(cells.load(tmp_path, content), tmp_path / "run")
    verdict = judge_run(tmp_path / "run")
    assert verdict.contact is not None
    assert verdict.contact.cause == "support"
    assert verdict.contacts_by_support >= 1
    assert verdict.short_ticks > 0
    assert summary["metrics"]["contact"] is True


def test_the_command_prints_a_table_and_json(folder, capsys):
    assert main(["judge", str(folder)]) == 0
    table = capsys.readouterr().out
    for what, value in lines(judge_run(folder)):
        assert what in table
        assert value.split()[0] in table
    assert main(["judge", str(folder), "--json", "--cap-m-s", "0.001"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["contacts"] == []
    assert told["arms"]["nurse"]["motion"]["capped_ticks"] > 0
    assert told["arms"]["surgeon"]["motion"]["capped_ticks"] is None


def test_a_folder_without_a_scene_is_refused(tmp_path, folder, capsys):
    (tmp_path / "trace.parquet").write_bytes((folder / "trace.parquet").read_bytes())
    with pytest.raises(TraceError, match=r"holds no scene/scene.xml"):
        judge_run(tmp_path)
    assert main(["judge", str(tmp_path)]) == 2


def test_the_judge_shares_nothing_with_the_controller():
    """Importing the judge loads neither the controller, nor the final check, nor mink."""
    import subprocess
    import sys

    code = "import sys, workcell.judge; print([m for m in sys.modules if m.startswith(('workcell.control', 'workcell.guard', 'mink'))])"
    found = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    assert found.strip() == "[]"


def test_motion_is_that_of_the_plant(folder):
    """Deviation, fastest point and jerk against their definitions, worked out anew."""
    from workcell.trace.table import load

    trace, verdict = load(folder), judge_run(folder)
    for arm in ("surgeon", "nurse"):
        error = np.linalg.norm(
            trace[f"{arm}.tool_position_m"] - trace[f"{arm}.target_position_m"], axis=1
        )
        motion = verdict.arms[arm].motion
        assert motion.target_error_m == pytest.approx(error.max(), abs=1e-9)
        assert motion.peak_point_speed_m_s >= trace[f"{arm}.tool_speed_m_s"].max() - 1e-9
        joints = [int(k) for k in trace.metadata["dofs"][arm]]
        jerk = np.diff(trace["plant_qvel"][:, joints], 2, axis=0) / 0.008**2
        assert motion.jerk_peak_rad_s3 == pytest.approx(np.abs(jerk).max())
