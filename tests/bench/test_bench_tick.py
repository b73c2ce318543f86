"""What a tick costs, as ratios within one process: `make bench`. Absolute figures are printed beside them.

The controller's whole tick (all pairs, both arms, every quantity a trace logs) with its row of the trace is held
against mink's solution of the two arms' inverse kinematics and nothing else: with mink's stock tasks and limits,
and with the controller's own, which cost mink more. The headless run with its trace and its final check is held
against the clock.
"""

from __future__ import annotations

import time
from pathlib import Path

import mink
import mujoco
import numpy as np
import pytest

from workcell import run as runner
from workcell import scenario as scenario_file
from workcell.control.controller import Controller
from workcell.control.ik import ArmIk
from workcell.control.laws import arithmetic
from workcell.provenance import layout, metadata
from workcell.scene import cell as scene
from workcell.scene.cell import Cell
from workcell.trace.writer import TraceWriter

STOCK_BUDGET, OWN_BUDGET = 2.6, 2.5
"""A whole tick may cost this many times `mink.solve_ik` with stock tasks and limits, and with our own. They are what is
reached on a busy machine; the aim for the first is 1.0. docs/performance.md says what stands in the way."""
ORDER_BUDGET = 1.15
"""A tick with second-order times may cost this many times one of first order: the aim, which is reached."""
REAL_TIME_BUDGETS = {"true": 1.0, "false": 2.0}
"""A headless run must be this many times faster than the clock, with and without the final check. These are floors; the
aim is 8."""


@pytest.fixture(scope="module")
def cell(tmp_path_factory) -> Cell:
    return scene.build(scenario_file.load("handover"), tmp_path_factory.mktemp("bench"))


@pytest.fixture(scope="module")
def states(cell) -> list[tuple[np.ndarray, np.ndarray]]:
    """The states of the first second of the run, in which the nurse is under way."""
    controller, data = Controller(cell), mujoco.MjData(cell.model)
    cell.place_home(data)
    found = []
    for _ in range(500):
        record = controller.step(data.qpos, data.qvel)
        found.append((data.qpos.copy(), data.qvel.copy()))
        data.qvel[:] = record.command_rad_s
        mujoco.mj_integratePos(cell.model, data.qpos, np.asarray(data.qvel), cell.period_s)
    return found


class WholeTick:
    """The controller, fed the recorded states over and over, and a row of the trace for each."""

    def __init__(self, cell: Cell, states, folder: Path):
        self._cell, self._states = cell, states
        self._trace = TraceWriter(folder, layout(cell), metadata(cell), cell.period_s)
        self._restart()

    def _restart(self) -> None:
        self._controller, self._next = Controller(self._cell), 0

    def __call__(self) -> None:
        if self._next == len(self._states):
            self._restart()
        self._trace.append(self._controller.step(*self._states[self._next]))
        self._next += 1


class BareIk:
    """mink alone: both arms' tasks, tool equalities and joint limits of the controller in one call."""

    def __init__(self, cell: Cell, states):
        self._states, self._next, self._dt = states, 0, cell.period_s
        self._configuration = mink.Configuration(cell.model)
        self._configuration.update(states[0][0])
        control = cell.scenario.control
        self._arms = [
            ArmIk(
                arm,
                nv=cell.model.nv,
                dt_s=cell.period_s,
                task_gain_per_s=control.task_gain_per_s,
                criterion_gain=control.criterion_gain,
            )
            for arm in cell.arms
        ]
        for arm in self._arms:
            arm.tool.set_target_from_configuration(self._configuration)
        self._program = {
            "tasks": [task for arm in self._arms for task in arm.tasks],
            "constraints": [task for arm in self._arms for task in arm.constraints],
            "limits": [arm.limit for arm in self._arms],
        }

    def __call__(self) -> None:
        qpos, _ = self._states[self._next % len(self._states)]
        self._next += 1
        self._configuration.update(qpos)
        for arm in self._arms:
            arm.tool.set_target_from_configuration(self._configuration)
        mink.solve_ik(self._configuration, dt=self._dt, solver="daqp", **self._program)


class StockIk:
    """mink alone as its examples use it: `FrameTask`, `ConfigurationLimit`, `VelocityLimit`, both arms in one call."""

    def __init__(self, cell: Cell, states):
        self._states, self._next, self._dt = states, 0, cell.period_s
        self._configuration = mink.Configuration(cell.model)
        self._configuration.update(states[0][0])
        self._tasks = [
            mink.FrameTask(arm.tool_site_name, "site", 1.0, 1.0, lm_damping=1e-6)
            for arm in cell.arms
        ]
        fastest = {
            cell.model.joint(joint).name: limit
            for arm in cell.arms
            for joint, limit in zip(arm.joints, arm.velocity_limit_rad_s, strict=True)
        }
        self._limits = [
            mink.ConfigurationLimit(cell.model),
            mink.VelocityLimit(cell.model, fastest),
        ]

    def __call__(self) -> None:
        qpos, _ = self._states[self._next % len(self._states)]
        self._next += 1
        self._configuration.update(qpos)
        for task in self._tasks:
            task.set_target_from_configuration(self._configuration)
        mink.solve_ik(
            self._configuration, self._tasks, self._dt, "daqp", damping=1e-3, limits=self._limits
        )


def median_s(function, rounds: int) -> float:
    times = []
    for _ in range(rounds):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def test_bare_inverse_kinematics(benchmark, cell, states):
    benchmark(BareIk(cell, states))


def test_whole_tick(benchmark, cell, states, tmp_path):
    benchmark(WholeTick(cell, states, tmp_path))


@pytest.mark.parametrize(
    ("bare", "budget"), [(StockIk, STOCK_BUDGET), (BareIk, OWN_BUDGET)], ids=["stock", "own"]
)
def test_a_tick_against_the_bare_inverse_kinematics(
    benchmark, cell, states, tmp_path, bare, budget
):
    """Measured in turns, so that both see the same machine."""
    assert len(cell.pairs) >= 64
    ratio = _in_turns(benchmark, WholeTick(cell, states, tmp_path), bare(cell, states))
    assert ratio <= budget


def test_a_tick_of_second_order_against_one_of_first(benchmark, cell, states, tmp_path):
    second = scene.build(scenario_file.load("handover", ("control.order=2",)), tmp_path / "scene")
    ratio = _in_turns(
        benchmark,
        WholeTick(second, states, tmp_path / "second"),
        WholeTick(cell, states, tmp_path / "first"),
    )
    assert ratio <= ORDER_BUDGET


def _in_turns(benchmark, tick, other) -> float:
    """Median ratio of two calls."""
    rounds = [(median_s(tick, 100), median_s(other, 100)) for _ in range(10)]
    benchmark(lambda: None)
    ratio = float(np.median([a / b for a, b in rounds]))
    benchmark.extra_info |= {"ratio": ratio, "kernels": arithmetic()}
    tick_us, other_us = (1e6 * float(np.median(column)) for column in zip(*rounds, strict=True))
    print(f"\n{arithmetic()}: {tick_us:.0f} µs and {other_us:.0f} µs, ratio {ratio:.2f}")
    return ratio


@pytest.mark.parametrize("check", ["true", "false"])
def test_a_whole_run_against_the_clock(benchmark, tmp_path, check):
    """All of `handover`, from the first tick to the closed trace."""
    built = runner.prepare(
        scenario_file.load("handover", (f"check.enabled={check}",)), tmp_path / "scene"
    )
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    benchmark.pedantic(runner.simulate, (built, tmp_path), rounds=1)
    simulated_s = built.scenario.simulation.duration_s
    by_wall, by_cpu = (
        simulated_s / spent for spent in (time.perf_counter() - wall_s, time.process_time() - cpu_s)
    )
    benchmark.extra_info |= {"times_real_time": by_wall, "times_real_time_cpu": by_cpu}
    print(
        f"\ncheck {check}: {by_wall:.2f} times real time by the wall, {by_cpu:.2f} by this process's time"
    )
    assert by_wall >= REAL_TIME_BUDGETS[check]
