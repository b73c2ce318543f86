"""The controller in front of robots: a clock, readings, the controller's tick, commands, and reasons to stop.

    wait for the tick's time
    read every robot       a reading that is too old, or a robot that stands by itself, stops all
    Controller.step        the same as in simulation, with the final check running beside it
    write every robot      numbered, so that the robots' own watchdogs and the readings' ages know which came
    append to the trace    measured positions stand for the plant

Who dies stops what: a robot, the others by this loop; this loop, the robots by their watchdogs; the checker, the
support arms by the controller. docs/robot.md has how long each took.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workcell import run as runner
from workcell.control.controller import Controller
from workcell.control.finite import positive
from workcell.errors import ControlFault, InputError
from workcell.guard.supervisor import LatchedCheck
from workcell.live.pace import Pace, RealTime
from workcell.loop import Ending, final_check
from workcell.provenance import layout, metadata
from workcell.robot.adapter import Reading, RobotAdapter
from workcell.scenario import Scenario
from workcell.scene.cell import Cell
from workcell.trace.writer import TraceWriter

Array = NDArray[np.float64]

STALE_S, STALE_TICKS = 0.05, 5
"""Age of a reading that stops the robots: the longer of the two; chosen as the final check's own deadline."""
WARM_UP_TICKS = 5
"""Ticks that are rehearsed before the clock starts: the first ones compile and fill caches."""
START_S = 5.0
"""Longest wait for the first reading of every robot."""
HOME_RAD = 0.01
"""How far a joint may be off `home_rad` at the start, where paths begin; chosen as half a degree."""
STOP_S = 5.0
"""Longest wait for robots to stand once they are told to stop; chosen above what any arm needs."""
STANDS_RAD_S = 1e-3
"""A joint slower than this stands, as far as encoders tell."""
FLUSH_WALL_S = 0.5
"""Wall-clock time of trace that a kill may cost."""
MOST_COMMANDS = 10_000
"""Commands whose time of sending is remembered."""


@dataclass
class RobotReport:
    """How it went, on the wall clock."""

    real_time: RealTime
    stopped: str = ""
    """Why the loop stopped the robots; empty if it ran to its end."""
    stopped_at_s: float | None = None
    """When, on the monotonic clock."""
    stood: bool = True
    """Whether all robots that answered stood in the end."""
    work_s: list[float] = field(default_factory=list)
    """Time each tick took, waiting aside."""
    age_s: list[float] = field(default_factory=list)
    """Age of the oldest reading of each tick: since the command was sent that the robot was acting on."""

    def summary(self) -> dict[str, Any]:
        """In numbers: 50, 99 and 100 of a hundred ticks."""
        return {
            "ticks": self.real_time.ticks,
            "missed": self.real_time.missed,
            "worst_late_s": self.real_time.worst_late_s,
            "work_s": _percentiles(self.work_s),
            "age_s": _percentiles(self.age_s),
            "stopped": self.stopped,
            "stood": self.stood,
        }


class RobotLoop:
    """Drives robots through a scenario.

    Args:
        scenario: Its arms are the robots, in their places; their jobs and operators say what is wanted. Its plant is
            not simulated. `simulation.latency_ticks` should cover the way to the robots and back.
        robots: For every arm the adapter of its robot.
        out: Run folder.
        stale_s: Age of a reading that stops all robots; None: five ticks, and 0.05 s at least.

    Raises:
        InputError: the scenario cannot be run, an arm has no robot, or instruments are to be carried, whose place
            nobody measures.
    """

    def __init__(
        self,
        scenario: Scenario,
        robots: Mapping[str, RobotAdapter],
        out: Path | str,
        *,
        stale_s: float | None = None,
    ):
        names = [arm.name for arm in scenario.arm]
        if set(robots) != set(names):
            raise InputError(
                f"robots are given for {', '.join(robots) or 'no arm'}; needed is one for each of {', '.join(names)}"
            )
        if scenario.instrument:
            raise InputError(
                "instrument: with real arms nobody measures where instruments are; take them out",
                file=scenario.file,
            )
        period_s = scenario.simulation.period_s
        shortest_s = max(STALE_S, STALE_TICKS * period_s)
        self._stale_s = shortest_s if stale_s is None else positive("stale_s", stale_s)
        self._robots, self._out = dict(robots), Path(out)
        self.cell: Cell = runner.start_folder(scenario, self._out)
        self._readings: dict[str, Reading] = {}
        self._sent_s: dict[int, float] = {}
        self._order: deque[int] = deque()
        self.check: LatchedCheck | None = None
        """The final check, while the loop runs."""
        self.report = RobotReport(RealTime(self.cell.period_s))

    def run(
        self, *, watch: Callable[[int, Controller], bool | None] | None = None
    ) -> dict[str, Any]:
        """Run to the scenario's end, or until something stops the robots; they stand afterwards.

        Args:
            watch: Called before every tick with its number and the controller; True ends the run.

        Returns:
            The summary, with `robots` added; see `RobotReport`.

        Raises:
            InputError: a robot does not answer, or is not where its arm starts.
        """
        cell, interrupted = self.cell, False
        with final_check(cell, self._out, live=True) as self.check:
            controller = Controller(cell, check=self.check)
            pace = Pace(cell.period_s)
            self.report.real_time = pace.account
            self._await_robots()
            self._rehearse()
            with TraceWriter(
                self._out, layout(cell), metadata(cell), cell.period_s, flush_wall_s=FLUSH_WALL_S
            ) as trace:
                try:
                    for tick in range(cell.scenario.ticks):
                        pace.wait(tick)
                        if watch and watch(tick, controller):
                            break
                        if not self._tick(controller, trace):
                            break
                except ControlFault as error:
                    self._stop(str(error))
                except KeyboardInterrupt:
                    interrupted = True
                finally:
                    self._stand()
        ending = Ending(
            controller.tick,
            self.report.stopped or "; ".join(controller.faults) or None,
            interrupted,
            None if self.check is None else self.check.account(),
        )
        return runner.conclude(cell, self._out, ending) | {"robots": self.report.summary()}

    # ---------------------------------------------------------------- a tick

    def _tick(self, controller: Controller, trace: TraceWriter) -> bool:
        """One tick; False once the robots are to stop."""
        began_s = time.monotonic()
        self._read()
        fault = self._fault(began_s)
        if fault:
            self._stop(fault)
            return False
        qpos, qvel = self._state()
        record = controller.step(qpos, qvel)
        number = controller.tick
        self._remember(number, time.monotonic())
        for arm in self.cell.arms:
            self._robots[arm.name].write(number, record.command_rad_s[arm.dofs])
        trace.append(record._replace(plant_qpos=qpos, plant_qvel=qvel))
        self.report.work_s.append(time.monotonic() - began_s)
        return True

    def _read(self) -> None:
        for name, robot in self._robots.items():
            reading = robot.read()
            if reading is not None:
                self._readings[name] = reading

    def _fault(self, now_s: float) -> str:
        """Why the robots must stop; empty if they need not."""
        oldest_s = 0.0
        for name, reading in self._readings.items():
            if reading.stopped:
                return f"robot {name} stands by itself: {reading.stopped}"
            if not (
                np.isfinite(reading.position_rad).all()
                and np.isfinite(reading.velocity_rad_s).all()
            ):
                return f"robot {name} says of its joints what is not finite"
            sent_s = self._sent_s.get(reading.acted_on)
            if sent_s is None:
                if reading.acted_on < 0 and not self._order:
                    continue  # nothing has been sent yet
                # The oldest command that is remembered is younger than what the robot acts on.
                sent_s = self._sent_s[self._order[0]]
            age_s = now_s - sent_s
            oldest_s = max(oldest_s, age_s)
            if age_s > self._stale_s:
                return f"robot {name} was last heard of {age_s:.3f} s ago; allowed is {self._stale_s:g} s"
        if self._order:
            self.report.age_s.append(oldest_s)
        return ""

    def _state(self) -> tuple[Array, Array]:
        """(nq,) and (nv,) as measured."""
        qpos, qvel = np.zeros(self.cell.model.nq), np.zeros(self.cell.model.nv)
        for arm in self.cell.arms:
            reading = self._readings[arm.name]
            qpos[arm.qpos], qvel[arm.dofs] = reading.position_rad, reading.velocity_rad_s
        return qpos, qvel

    def _remember(self, number: int, now_s: float) -> None:
        self._sent_s[number] = now_s
        self._order.append(number)
        if len(self._order) > MOST_COMMANDS:
            del self._sent_s[self._order.popleft()]

    # ---------------------------------------------------------------- start and stop

    def _await_robots(self) -> None:
        """Wait for the first reading of every robot, which must be where its arm starts."""
        until_s = time.monotonic() + START_S
        while len(self._readings) < len(self._robots) and time.monotonic() < until_s:
            self._read()
            time.sleep(0.001)
        silent = [name for name in self._robots if name not in self._readings]
        if silent:
            raise InputError(
                [f"robot {name}: has not answered within {START_S:g} s" for name in silent]
            )
        faults = []
        for arm in self.cell.arms:
            position = self._readings[arm.name].position_rad
            if position.shape != arm.home_rad.shape:
                faults.append(
                    f"robot {arm.name}: tells of {len(position)} joints; its arm has {len(arm.home_rad)}"
                )
                continue
            off = np.abs(position - arm.home_rad)
            for k in np.flatnonzero(~(off <= HOME_RAD)):
                faults.append(
                    f"robot {arm.name}: {arm.joints[k]} is at {position[k]:.4f}, home_rad has {arm.home_rad[k]:.4f}; "
                    f"allowed is {HOME_RAD:g} apart: move it there first, or set arm.{arm.name}.home_rad"
                )
        if faults:
            raise InputError(faults, file=self.cell.scenario.file)

    def _rehearse(self) -> None:
        """What a first tick would need time for is done before the clock starts."""
        qpos, qvel = self._state()
        rehearsed = Controller(self.cell)
        for _ in range(WARM_UP_TICKS):
            rehearsed.step(qpos, qvel)
        if self.check is not None:
            self.check.ask(0, qpos, (), {})

    def _stop(self, reason: str) -> None:
        """Tell all robots to stop."""
        if not self.report.stopped:
            self.report.stopped, self.report.stopped_at_s = reason, time.monotonic()
        for robot in self._robots.values():
            robot.stop(reason)

    def _stand(self) -> None:
        """Tell the robots to stop until those that answer stand; let go of them."""
        until_s, standing = time.monotonic() + STOP_S, False
        last_heard_s = dict.fromkeys(self._robots, time.monotonic())
        while not standing and time.monotonic() < until_s:
            standing = True
            for name, robot in self._robots.items():
                robot.stop(self.report.stopped or "the run is over")
                reading = robot.read()
                now_s = time.monotonic()
                if reading is not None:
                    self._readings[name], last_heard_s[name] = reading, now_s
                if now_s - last_heard_s[name] > 10.0 * self._stale_s:
                    continue  # it does not answer any more: nothing to wait for
                last = self._readings.get(name)
                standing &= last is not None and bool(
                    last.stopped and (np.abs(last.velocity_rad_s) < STANDS_RAD_S).all()
                )
            time.sleep(self.cell.period_s)
        self.report.stood = standing
        for robot in self._robots.values():
            robot.close()


def _percentiles(values: list[float]) -> dict[str, float] | None:
    if not values:
        return None
    median, p99 = np.percentile(values, [50, 99])
    return {"median": float(median), "p99": float(p99), "largest": float(max(values))}
