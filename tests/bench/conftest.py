"""What the benchmarks measure on: the states of a real run, and how a series of times is told."""

from __future__ import annotations

import time
from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from workcell import scenario as scenario_file
from workcell.control.controller import Controller
from workcell.scene import cell as scene
from workcell.scene.cell import Cell

State = tuple[np.ndarray, np.ndarray]


@pytest.fixture(scope="session")
def cell(tmp_path_factory) -> Cell:
    return scene.build(scenario_file.load("handover"), tmp_path_factory.mktemp("bench"))


@pytest.fixture(scope="session")
def states(cell) -> list[State]:
    """The states of the first two seconds of the run, in which the nurse is under way."""
    return drive(cell, ticks=1000)


def drive(cell: Cell, ticks: int) -> list[State]:
    """States of a run in which every joint does what it is commanded."""
    controller, data = Controller(cell), mujoco.MjData(cell.model)
    cell.place_home(data)
    found = []
    for _ in range(ticks):
        record = controller.step(data.qpos, data.qvel)
        found.append((data.qpos.copy(), data.qvel.copy()))
        data.qvel[:] = record.command_rad_s
        mujoco.mj_integratePos(cell.model, data.qpos, np.asarray(data.qvel), cell.period_s)
    return found


class Stopwatch:
    """Wall-clock and processor time of a series of calls, in microseconds.

    Ratios are taken of processor times: on a machine that others use as well, a wall clock mostly
    tells how long this process had to wait.
    """

    def __init__(self):
        self._wall: list[int] = []
        self._cpu: list[int] = []

    def __len__(self) -> int:
        return len(self._cpu)

    def time(self, function: Callable[..., object], *arguments, **keywords):
        wall, cpu = time.perf_counter_ns(), time.thread_time_ns()
        try:
            return function(*arguments, **keywords)
        finally:
            self._cpu.append(time.thread_time_ns() - cpu)
            self._wall.append(time.perf_counter_ns() - wall)

    @property
    def median_us(self) -> float:
        """Median processor time."""
        return float(np.median(self._cpu)) / 1e3

    def told(self) -> dict[str, float]:
        """The figures that the tables hold."""
        low, middle, high, worst = np.percentile(self._wall, [10, 50, 99, 100]) / 1e3
        return {
            "cpu_median_us": round(self.median_us, 1),
            "cpu_p99_us": round(float(np.percentile(self._cpu, 99)) / 1e3, 1),
            "p10_us": round(float(low), 1),
            "median_us": round(float(middle), 1),
            "p99_us": round(float(high), 1),
            "worst_us": round(float(worst), 1),
        }


def timed(function: Callable[[], object], rounds: int) -> Stopwatch:
    """Times a call over and over, garbage collection left on as in a run."""
    watch = Stopwatch()
    for _ in range(rounds):
        watch.time(function)
    return watch
