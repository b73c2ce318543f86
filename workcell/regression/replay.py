"""A recorded run once more: the same controller inputs, or the same scenario.

    open loop     the recorded states go into a fresh controller tick by tick, and its outputs into a
                  new trace. Whatever differs was changed in the controller: no plant took part.
    closed loop   the scenario is run again; differences of plant and controller add up.

Jobs and scripted operators are part of the controller and start again from the scenario. The final
check, a process of its own, is represented by what it said, a live operator by what was wanted.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from workcell import run as runner
from workcell.control.controller import Controller
from workcell.errors import ControlFault, TraceError
from workcell.guard.halt import HaltLatch
from workcell.guard.verdict import CheckState, Verdict
from workcell.motion.path import Target
from workcell.motion.setpoint import Setpoint
from workcell.provenance import layout, metadata
from workcell.regression.rows import States, Targets
from workcell.scenario import Live, Scenario
from workcell.scene.cell import Cell
from workcell.trace.table import Trace, load
from workcell.trace.writer import TraceWriter

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Replay:
    """A run that was done again."""

    trace: Trace
    """What came out this time."""
    summary: Mapping[str, Any] | None
    """Its summary; None for an open loop, which has no run to judge."""
    fault: str | None
    """What stopped it before the end."""


class RecordedCheck:
    """The final check of a recorded run: says again what it said then.

    Args:
        states: What the controller was fed, the check's answers among it.
        period_s: Control period.
    """

    def __init__(self, states: States, period_s: float):
        self._states = states
        self._latch = HaltLatch(period_s)

    @property
    def halted(self) -> bool:
        """Whether it had said stop."""
        return self._latch.latched

    def ask(
        self,
        tick: int,
        qpos: NDArray[np.float64],
        windows: Collection[str],
        holders: Mapping[str, str | None],
    ) -> Verdict:
        """The recorded verdict of this tick."""
        distance = float(self._states.check_distance_m[tick])
        verdict = Verdict(
            state=CheckState(self._states.check_state[tick]),
            sequence=0,
            tick=tick,
            age_ticks=0,
            distance_m=None if np.isnan(distance) else distance,
            pair=None,
            exempt_distance_m=None,
            reason="as recorded",
        )
        self._latch.trip(verdict, tick)
        return verdict

    def observe(
        self, tick: int, arm: str, tool_speed_m_s: float, qvel_rad_s: NDArray[np.float64]
    ) -> None:
        """How an arm comes to rest was observed when it happened."""


class RecordedOperator:
    """A live operator of a recorded run: wants again what was wanted then.

    Args:
        targets: What was wanted at each tick.
        period_s: Control period.
    """

    def __init__(self, targets: Targets, period_s: float):
        self._targets = targets
        self._period_s = period_s

    def setpoint(self, time_s: float) -> Setpoint:
        """The recorded setpoint of this tick."""
        then, now = self._targets, round(time_s / self._period_s)
        target = Target(
            then.position_m[now], then.wxyz[now], then.velocity_m_s[now], then.turn_rad_s[now]
        )
        return Setpoint(target, str(then.job[now]), str(then.state[now]))


def open_loop(cell: Cell, states: States, out: Path, *, progress: Progress | None = None) -> Replay:
    """Feed recorded states to a fresh controller.

    Args:
        cell: The cell of the recorded run.
        states: What its controller was fed.
        out: Folder the new trace is written to.
        progress: Called with (ticks done, ticks in all) now and then.
    """
    controller = Controller(cell, check=RecordedCheck(states, cell.period_s))
    for arm in cell.scenario.arm:
        if isinstance(arm.operator, Live):
            if arm.name not in states.targets:
                raise TraceError(
                    f"{arm.name}: its operator was live, and its targets were not kept"
                )
            controller.drive(arm.name, RecordedOperator(states.targets[arm.name], cell.period_s))
    fault = None
    with TraceWriter(out, layout(cell), metadata(cell), cell.period_s) as trace:
        try:
            for tick, (qpos, qvel) in enumerate(zip(states.qpos, states.qvel, strict=True)):
                changed = {
                    name: values[tick]
                    for name, values in states.tuning.items()
                    if values[tick] != getattr(controller.settings, name)
                }
                if changed:
                    controller.tune(**changed)
                trace.append(controller.step(qpos, qvel))
                if progress and tick % 250 == 0:
                    progress(tick, len(states))
        except ControlFault as error:
            fault = str(error)
    if progress:
        progress(len(states), len(states))
    return Replay(load(out), None, fault)


def closed_loop(scenario: Scenario, out: Path, *, progress: Progress | None = None) -> Replay:
    """Run a scenario again; unlike `run`, no recording is made of it."""
    cell = runner.prepare(scenario, out / runner.SCENE_FOLDER)
    ending = runner.simulate(cell, out, progress=progress)
    trace = load(out)
    return Replay(trace, runner.summarise(cell, trace, ending), ending.fault)


def scenario_of(trace: Trace) -> Scenario:
    """The resolved scenario a trace carries.

    Raises:
        TraceError: it carries none, or one this version cannot read.
    """
    settings = trace.metadata.get("settings")
    if not settings:
        raise TraceError(f"{trace.source}: carries no scenario, so that it cannot be run again")
    try:
        return Scenario.model_validate(settings)
    except ValidationError as error:
        raise TraceError(
            f"{trace.source}: this version cannot read its scenario: {error}"
        ) from error
