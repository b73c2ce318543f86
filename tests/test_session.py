"""A session is the run, tick by tick: the same trace to the last bit, one after the other and in turns."""

from __future__ import annotations

import os
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests import cells
from workcell import InputError, Session, Twist
from workcell import run as runner
from workcell.errors import ControlFault
from workcell.motion.path import Target
from workcell.motion.setpoint import Setpoint
from workcell.simulation.plant import Plant
from workcell.trace.table import load

SHORT = ("simulation.duration_s=0.8",)
OFF = ("check.enabled=false",)


def scenario(folder: Path, *overrides: str, **control):
    return cells.load(folder, cells.duet(**control), *SHORT, *overrides)


def to_the_end(session: Session) -> list:
    records = []
    while not session.done:
        records.append(session.step())
    return records


@pytest.mark.parametrize("plant", ["kinematic", "dynamic"])
def test_its_trace_and_summary_are_those_of_the_run(tmp_path, plant):
    what = scenario(tmp_path, f"simulation.plant={plant}", "simulation.position_noise_rad=1e-5")
    expected = runner.run(what, tmp_path / "run")
    with Session(what, out=tmp_path / "session") as session:
        records = to_the_end(session)
        summary = session.finish()
    run, stepped = tmp_path / "run", tmp_path / "session"
    assert (run / "trace.parquet").read_bytes() == (stepped / "trace.parquet").read_bytes()
    assert {p.name for p in run.iterdir()} == {p.name for p in stepped.iterdir()}
    assert summary["metrics"] == expected["metrics"]
    assert summary["final_check"]["halt"] is None
    assert len(records) == 100
    assert records[50].arms["nurse"].job.startswith("meet")


def test_every_reset_is_a_run_of_its_own_with_its_seed(tmp_path):
    what = scenario(tmp_path, "simulation.position_noise_rad=1e-4", *OFF)
    with Session(what, out=tmp_path / "session") as session:
        for seed in (0, 3, 0):
            session.reset(seed=seed)
            to_the_end(session)
            assert session.scenario.simulation.seed == seed
    digests = [load(tmp_path / name).digest() for name in ("session", "session_2", "session_3")]
    assert digests[0] == digests[2] != digests[1]
    other = scenario(tmp_path, "simulation.position_noise_rad=1e-4", "simulation.seed=3", *OFF)
    runner.run(other, tmp_path / "run")
    assert load(tmp_path / "run").digest() == digests[1]


def test_sessions_take_turns_in_one_process(tmp_path):
    """Two at a time, tick by tick, do what each does alone."""
    whats = [
        scenario(tmp_path, f"simulation.seed={k}", "simulation.position_noise_rad=1e-4", *OFF)
        for k in (1, 2)
    ]
    alone = []
    for what in whats:
        with Session(what) as session:
            alone.append([record.qpos for record in to_the_end(session)])
    with Session(whats[0]) as first, Session(whats[1]) as second:
        for k in range(100):
            for session, rows in zip((first, second), alone, strict=True):
                np.testing.assert_array_equal(session.step().qpos, rows[k])
    assert mujoco.get_mjcb_control() is None


def _end_of(seed: int) -> list[float]:
    with Session("planar_crossing", (*SHORT, *OFF, f"simulation.seed={seed}")) as session:
        return to_the_end(session)[-1].qpos.tolist()


def test_sessions_run_in_processes():
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        assert pool.submit(_end_of, 4).result() == _end_of(4)


def test_its_checker_ends_with_it(tmp_path):
    with Session(scenario(tmp_path)) as session:
        session.step()
        first = session._loop.check._check.pid
        os.kill(first, 0)
        session.reset()
        with pytest.raises(ProcessLookupError):
            os.kill(first, 0)
        session.step()
        second = session._loop.check._check.pid
    with pytest.raises(ProcessLookupError):
        os.kill(second, 0)
    assert not session.folder.exists(), "without `out` nothing is kept"


@pytest.mark.parametrize("arm", ["nurse", "surgeon"])
def test_a_command_is_done_in_the_place_of_job_or_operator(tmp_path, arm):
    with Session(scenario(tmp_path, "control.t_min_s=0.3", *OFF)) as session:
        back = {"nurse": [0.4, 0.0, 0.2], "surgeon": [-0.4, 0.0, 0.2]}[arm]
        for _ in range(60):
            record = session.step({arm: back})
        dofs = next(each.dofs for each in session.cell.arms if each.name == arm)
        np.testing.assert_allclose(record.command_rad_s[dofs], back, atol=1e-12)
        assert record.arms[arm].reason == "commanded"
        record = session.step()
        assert record.arms[arm].reason != "commanded", "it lasts a tick"


def test_a_twist_moves_the_tool(tmp_path):
    with Session(scenario(tmp_path, *OFF)) as session:
        before = session.step().arms["surgeon"].tool_position_m
        for _ in range(100):
            record = session.step({"surgeon": Twist([0.0, 0.1, 0.0])})
        way = record.arms["surgeon"].tool_position_m - before
        # 0.8 s at 0.1 m/s, less the time to speed up
        assert way[1] == pytest.approx(0.08, abs=0.01)
        assert np.abs(way[[0, 2]]).max() < 0.002


@pytest.mark.parametrize(("arm", "gate"), [("nurse", True), ("surgeon", True), ("surgeon", False)])
def test_commands_pass_the_gate_whatever_the_arms_role(tmp_path, arm, gate):
    """An arm is stretched out to where the other's tool is: behind the gate it stops before, without it they meet."""
    # Without the gate the final check must be on; it stops support arms alone.
    switch = OFF if gate else ("control.gate=false",)
    content = cells.duet()
    content["arm"][0]["base_position_m"] = [0.3, 0.0, 0.0]
    what = cells.load(tmp_path, content, "simulation.duration_s=2.4", *switch)
    other, goal_rad = ("surgeon", [0.6, 0, 0]) if arm == "nurse" else ("nurse", [2.27, 0, 0])
    with Session(what) as session:
        dofs = next(each.dofs for each in session.cell.arms if each.name == arm)
        nearest_m = np.inf
        while not session.done:
            wanted = np.clip(3.0 * (goal_rad - session.state.qpos[dofs]), -1.5, 1.5)
            record = session.step({arm: wanted, other: [0.0, 0.0, 0.0]})
            nearest_m = min(nearest_m, record.pair_distance_m.min())
    assert (nearest_m > 0.0) == gate
    assert nearest_m < 0.15, "it was on its way"


class Circles:
    """An operator of one's own."""

    def setpoint(self, time_s: float) -> Setpoint:
        position = np.array([0.2 + 0.02 * np.cos(time_s), 0.5 + 0.02 * np.sin(time_s), 0.3])
        speed = 0.02 * np.array([-np.sin(time_s), np.cos(time_s), 0.0])
        return Setpoint(Target(position, np.array([1.0, 0, 0, 0]), speed, np.zeros(3)), "circles")


def test_an_operator_of_ones_own_drives_a_priority_arm(tmp_path):
    with Session(scenario(tmp_path, *OFF)) as session:
        session.drive("surgeon", Circles())
        assert session.step().arms["surgeon"].job == "circles"
        session.reset()
        assert session.step().arms["surgeon"].job == "circles"
        with pytest.raises(InputError, match=r"'nurse': is no priority arm.*surgeon"):
            session.drive("nurse", Circles())


@pytest.mark.parametrize(
    ("commands", "words"),
    [
        ({"nuse": [0, 0, 0]}, "'nuse': unknown; did you mean 'nurse'"),
        ({"nurse": [0, 0]}, r"command of nurse has shape \(2,\); allowed is \(3,\)"),
        ({"nurse": [0, float("nan"), 0]}, "must be finite"),
        ({"nurse": Twist([1.0])}, "velocity_m_s of nurse"),
        ({"nurse": Twist([0, 0, 0], [0, 0, float("inf")])}, "angular_velocity_rad_s of nurse"),
    ],
)
def test_commands_that_make_no_sense_are_refused_and_nothing_is_done(tmp_path, commands, words):
    with Session(scenario(tmp_path, *OFF)) as session:
        session.step()
        before = session.state
        with pytest.raises(InputError, match=words):
            session.step({"surgeon": [1.0, 0.0, 0.0], **commands})
        assert session.state.time_s == before.time_s
        assert session.step().arms["surgeon"].reason != "commanded"


def test_what_is_over_or_wrong_is_refused(tmp_path):
    with pytest.raises(InputError, match="overrides"):
        Session(scenario(tmp_path), SHORT)
    with pytest.raises(InputError, match="planar_crossin"):
        Session("planar_crossin")
    with Session(scenario(tmp_path, *OFF)) as session:
        with pytest.raises(InputError, match=r"seed is -1"):
            session.reset(seed=-1)
        assert session.scenario.simulation.seed == 0
        session.step()
        with pytest.raises(InputError, match="run folder"):
            session.finish()
    for what in (session.step, session.finish, lambda: session.state):
        with pytest.raises(InputError, match=r"the run is over: reset\(\) begins another"):
            what()


def test_a_fault_is_raised_and_told_in_the_summary(tmp_path, monkeypatch):
    real = Plant.step

    def breaking(plant, controller):
        if controller.tick == 20:
            plant.data.qpos[1] = np.nan
        return real(plant, controller)

    monkeypatch.setattr(Plant, "step", breaking)
    with Session(scenario(tmp_path, *OFF), out=tmp_path / "run") as session:
        with pytest.raises(ControlFault, match="tick 20"):
            to_the_end(session)
        summary = session.finish()
    assert summary["metrics"]["fault"].startswith("tick 20")
    assert len(load(tmp_path / "run")) == 20
