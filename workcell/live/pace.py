"""The wall clock: holds a run back to it, says how well it keeps up, and finds the period that this machine can hold."""

from __future__ import annotations

import tempfile
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from workcell import run as runner
from workcell.control.controller import Controller
from workcell.errors import InputError
from workcell.loop import final_check
from workcell.scenario import Scenario

GIVE_UP_S = 0.1
"""When this far behind the clock, the run goes on from where it is instead of racing to catch up."""
WINDOW_S = 2.0
"""The speed that is shown is that of the last so many seconds; chosen as long as a person looks before asking."""
HELD_SHARE = 0.93
"""A run at least this fast counts as real time."""
PERIODS_S = (0.002, 0.004, 0.005, 0.008, 0.01, 0.016, 0.02)
"""Periods to choose from when that of the scenario cannot be held."""
TRIAL_S = 1.5
WARM_UP_TICKS = 20
"""The first ticks compile and fill caches."""
ROOM = 0.6
"""Share of a period that nine of ten ticks may take: the rest is for moving arms, the page and other programs."""


@dataclass
class RealTime:
    """How well a live run kept to the clock."""

    period_s: float = 0.0
    """Length of a tick."""
    ticks: int = 0
    missed: int = 0
    """Ticks that began more than one period after their time."""
    worst_late_s: float = 0.0
    """Largest lateness of a tick."""
    slipped_s: float = 0.0
    """Time by which the run fell behind the clock for good."""
    frames: int = 0
    """Pictures shown."""


class Pace:
    """Holds a run back to the wall clock.

    Args:
        period_s: Length of a tick.
        clock, sleep: Replaced in tests.
    """

    def __init__(
        self,
        period_s: float,
        *,
        clock: Callable[[], float] = time.perf_counter,
        sleep: Callable[[float], None] = time.sleep,
    ):
        self._period_s, self._clock, self._sleep = period_s, clock, sleep
        self._start_s: float | None = None
        self._began: deque[float] = deque(maxlen=max(2, round(WINDOW_S / period_s)))
        self.account = RealTime(period_s)

    def wait(self, tick: int) -> None:
        """Return when it is time for a tick, at once if that is past."""
        now = self._clock()
        if self._start_s is None:
            self._start_s = now - tick * self._period_s
        late = now - self._start_s - tick * self._period_s
        account = self.account
        account.ticks += 1
        account.worst_late_s = max(account.worst_late_s, late)
        if late < 0.0:
            self._sleep(-late)
        elif late > self._period_s:
            account.missed += 1
        if late > GIVE_UP_S:
            self._start_s += late
            account.slipped_s += late
        self._began.append(self._clock())

    def resume(self) -> None:
        """Time has stood still on purpose: count from the next tick on."""
        self._start_s = None
        self._began.clear()

    @property
    def speed(self) -> float:
        """Simulated by passed time over the last `WINDOW_S`, at most 1; 1 until there is enough to tell."""
        if len(self._began) < self._began.maxlen // 2 + 1:  # pyright: ignore[reportOptionalOperand]
            return 1.0
        passed_s = self._began[-1] - self._began[0]
        return min(1.0, (len(self._began) - 1) * self._period_s / max(passed_s, 1e-9))


def speed_words(speed: float) -> str:
    """How fast a run goes, as a person would say it."""
    if speed >= HELD_SHARE:
        return "real time"
    return (
        f"half speed ({100 * speed:.0f} %)" if 0.4 < speed < 0.6 else f"{100 * speed:.0f} % speed"
    )


@dataclass(frozen=True)
class Choice:
    """A scenario with the period it is run at."""

    scenario: Scenario
    said: str
    """One line for the person."""


def choose_period(scenario: Scenario, *, keep: bool = False) -> Choice:
    """The scenario at its own period if this machine can hold it, else at the smallest one that it can.

    Args:
        scenario: What is to be run.
        keep: Whether the period was asked for and is kept, held or not.
    """
    own_s = scenario.simulation.period_s
    needs_s = tick_s(scenario) / ROOM
    if needs_s <= own_s:
        return Choice(scenario, f"ticks of {1e3 * own_s:g} ms, in real time")
    if keep:
        return Choice(
            scenario,
            f"ticks of {1e3 * own_s:g} ms as asked; this machine needs {1e3 * needs_s:.1f} ms, so the run may be slower than the clock",
        )
    chosen = scenario
    for period_s in PERIODS_S:
        if period_s <= own_s:
            continue
        try:
            candidate = at_period(scenario, period_s)
        except InputError:
            break  # what is longer leaves even less room to brake
        chosen = candidate
        if needs_s <= period_s:
            return Choice(
                chosen,
                f"ticks of {1e3 * period_s:g} ms instead of {1e3 * own_s:g} ms, which this machine cannot hold",
            )
    return Choice(
        chosen,
        f"ticks of {1e3 * chosen.simulation.period_s:g} ms, the longest this scenario allows; this machine needs {1e3 * needs_s:.1f} ms, so the run is slower than the clock",
    )


def at_period(scenario: Scenario, period_s: float) -> Scenario:
    """The same scenario at another period.

    Raises:
        InputError: it cannot be run at that period.
    """
    content = scenario.model_copy(
        update={"simulation": scenario.simulation.model_copy(update={"period_s": period_s})}
    )
    with tempfile.TemporaryDirectory() as folder:
        runner.prepare(content, Path(folder))
    return content


def tick_s(scenario: Scenario) -> float:
    """Wall time that nine of ten ticks stay below here and now, found by running the start of the scenario."""
    began: list[float] = []

    def watch(tick: int, data: mujoco.MjData, controller: Controller) -> bool:
        began.append(time.perf_counter())
        enough = len(began) > 2 * WARM_UP_TICKS
        return enough and began[-1] - began[WARM_UP_TICKS] > TRIAL_S

    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        cell = runner.prepare(scenario, out / runner.SCENE_FOLDER)
        with final_check(cell, out, live=True) as check:
            runner.simulate(cell, out, watch=watch, check=check)
    took = np.diff(began[WARM_UP_TICKS:])
    return float(np.percentile(took, 90)) if len(took) else 0.0
