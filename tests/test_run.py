"""A run from end to end: the same twice, readable whatever ends it, and honest about how it ended."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests import cells
from workcell import run as runner
from workcell import scenario as scenario_file
from workcell.errors import InputError
from workcell.simulation.plant import Plant
from workcell.trace.table import load

SHORT = ("simulation.duration_s=1.6",)


def run(folder: Path, *overrides: str, **control) -> dict:
    return runner.run(cells.load(folder, cells.duet(**control), *overrides), folder / "run")


@pytest.fixture(scope="module", params=["kinematic", "dynamic"])
def twice(request, tmp_path_factory) -> tuple[Path, Path]:
    """The same scenario run into two folders."""
    folders = tmp_path_factory.mktemp("first"), tmp_path_factory.mktemp("second")
    for folder in folders:
        run(folder, *SHORT, f"simulation.plant={request.param}")
    return folders[0] / "run", folders[1] / "run"


def test_the_same_command_twice_gives_the_same_trace_bit_for_bit(twice):
    first, second = (load(folder) for folder in twice)
    assert len(first) == 200
    assert (first["nurse.scale"] < 1.0).any(), "a run in which nothing happens proves nothing"
    assert first.digest() == second.digest()
    assert (twice[0] / "trace.parquet").read_bytes() == (twice[1] / "trace.parquet").read_bytes()


def test_a_run_folder_holds_what_it_promises(twice):
    folder = twice[0]
    names = {path.name for path in folder.iterdir()}
    assert {"scenario.toml", "scene", "trace.parquet", "recording.rrd", "summary.json"} <= names
    model = mujoco.MjModel.from_xml_path(str(folder / "scene" / "scene.xml"))
    trace, summary = load(folder), json.loads((folder / "summary.json").read_text())
    assert trace.layout.nv == model.nv
    for pair in trace.layout.pairs:
        assert all(model.geom(name).id >= 0 for name in pair)
    again = scenario_file.load(folder / "scenario.toml")
    assert again.digest() == summary["scenario_sha256"] == trace.metadata["scenario"]
    assert summary["watched_pairs"] == len(trace.layout.pairs)
    assert summary["metrics"]["ticks"] == len(trace)
    assert set(summary["versions"]) >= {"workcell", "mujoco", "mink", "daqp"}


def test_a_run_says_which_phase_begins(tmp_path):
    told = []
    scenario = cells.load(
        tmp_path, cells.duet(), "simulation.duration_s=0.1", "check.enabled=false"
    )
    runner.run(
        scenario, tmp_path / "run",
        progress=lambda done, total: told.append(done), phase=told.append,
    )  # fmt: skip
    names = [what for what in told if isinstance(what, str)]
    assert names == ["preparing", "simulating", "judging", "recording"]
    between = told[told.index("simulating") : told.index("judging")]
    assert between[-1] == scenario.ticks, "ticks are counted while it simulates"


def test_time_is_tick_times_period(twice):
    trace = load(twice[0])
    np.testing.assert_array_equal(trace["tick"], np.arange(200))
    np.testing.assert_allclose(trace["time_s"], np.arange(200) * 0.008, rtol=0, atol=1e-12)


def test_both_plants_do_nearly_the_same(tmp_path):
    """The exact kinematic plant and MuJoCo's dynamics are two plants under one controller."""
    tools = []
    for plant in ("kinematic", "dynamic"):
        run(tmp_path / plant, *SHORT, f"simulation.plant={plant}")
        tools.append(load(tmp_path / plant / "run")["nurse.tool_position_m"])
    assert np.linalg.norm(tools[0][-1] - tools[0][0]) > 0.1
    assert np.abs(tools[0] - tools[1]).max() < 2e-3


def test_without_the_check_the_run_says_so(tmp_path):
    summary = run(tmp_path, *SHORT, "check.enabled=false")
    assert set(load(tmp_path / "run")["check_state"]) == {"off"}
    assert summary["metrics"]["smallest_check_distance_m"] is None


@pytest.mark.parametrize(
    ("expect", "held"),
    [
        ({"contact": False}, True),
        ({"completed": True}, False),
        ({"nurse.peak_tool_speed_m_s": {"min": 0.1, "max": 0.2}}, True),
        ({"nurse.peak_tool_speed_m_s": {"max": 0.1}}, False),
        ({"nurse.peak_tool_sped_m_s": {"max": 9.0}}, False),
        ({"nurse.retreat_smallest_scale": {"min": 0.0}}, False),
    ],
    ids=["equal", "unequal", "within", "beyond", "misspelt", "without a value"],
)
def test_expectations_are_judged(twice, expect, held):
    from workcell.trace.expectations import judge

    metrics = json.loads((twice[0] / "summary.json").read_text())["metrics"]
    content = cells.duet() | {"expect": expect}
    wanted = cells.load(twice[0] / "expectation", content).expect
    (verdict,) = judge(metrics, wanted).values()
    assert verdict["held"] is held


@pytest.mark.parametrize(
    ("expect", "held"),
    [({}, False), ({"completed": False}, False), ({"contact": True}, True)],
    ids=["nothing", "something else", "the contact"],
)
def test_a_contact_that_nobody_expects_is_no_success(tmp_path, expect, held):
    content = cells.duet() | {"check": {"enabled": False}, "expect": expect}
    content["arm"][0]["operator"] = {
        "kind": "waypoints",
        "speed_m_s": 0.5,
        "waypoints": [{"position_m": [-0.166, 0.25, 0.3]}],
    }
    content["obstacle"] = [
        {"name": "post", "shape": "box", "size_m": [0.03] * 3, "position_m": [-0.166, 0.3, 0.3]}
    ]
    loaded = cells.load(tmp_path, content, "simulation.duration_s=2.5")
    summary = runner.run(loaded, tmp_path / "run")
    assert summary["metrics"]["contact"]
    assert summary["held"] is held
    assert any("workcell judge" in line for line in summary["why"]) is not held


def test_a_state_that_is_not_finite_ends_the_run_with_its_tick(tmp_path, monkeypatch):
    """The plant breaks at tick 50: the run stops, says where, and the 50 ticks before are readable."""
    real = Plant.step

    def breaking(plant, controller):
        if controller.tick == 50:
            plant.data.qpos[1] = np.nan
        return real(plant, controller)

    monkeypatch.setattr(Plant, "step", breaking)
    summary = run(tmp_path, *SHORT)
    assert summary["held"] is False
    assert summary["metrics"]["fault"].startswith("tick 50: qpos, the measured joint positions")
    assert len(load(tmp_path / "run")) == 50
    assert (tmp_path / "run" / "recording.rrd").is_file()
    assert mujoco.get_mjcb_control() is None


def test_what_cannot_be_run_leaves_no_trace(tmp_path):
    with pytest.raises(InputError, match="t_min_s"):
        run(tmp_path, t_min_s=0.01)
    assert not (tmp_path / "run" / "trace.parquet").exists()


def start(folder: Path) -> tuple[subprocess.Popen, Path]:
    """A run far too long to wait for, in a process of its own, once it has written rows."""
    path = cells.write(folder, cells.duet())
    out = folder / "out"
    command = [sys.executable, "-m", "workcell", "run", str(path), "--out", str(out)]
    process = subprocess.Popen(
        [*command, "--set", "simulation.duration_s=3000"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(Path(runner.__file__).parents[1])},
    )
    journal, deadline = out / "trace.arrows", time.monotonic() + 60
    while not (journal.is_file() and journal.stat().st_size > 100_000):
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.05)
    return process, out


def test_ctrl_c_leaves_a_whole_run_folder(tmp_path):
    process, out = start(tmp_path)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 1, errors
    assert "Traceback" not in errors
    summary = json.loads((out / "summary.json").read_text())
    assert summary["metrics"]["interrupted"] is True
    assert summary["held"] is False
    assert len(load(out)) == summary["metrics"]["ticks"] > 50
    assert (out / "recording.rrd").is_file()
    assert not (out / "trace.arrows").exists()


def test_a_kill_leaves_all_but_the_last_second(tmp_path):
    process, out = start(tmp_path)
    process.kill()
    process.wait(timeout=30)
    process.communicate()
    trace = load(out)
    assert len(trace) > 50
    np.testing.assert_array_equal(trace["tick"], np.arange(len(trace)))
