"""One quantity of a run held against a reference's, tick by tick.

Two values agree where |a - b| <= atol + rtol |b| with the tolerances of `workcell.signals`. Times to
collision are compared as their reciprocals, orientations up to the sign of the quaternion.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workcell.signals import Column

TTC_SIGNALS = ("ttc_s", "ttc_command_s")
"""Signals that are a time to collision."""
PLANT_REASON = "servo_lag"
"""A reason the plant gives, not the controller; an open loop, which has no plant, passes it over."""


@dataclass(frozen=True)
class Difference:
    """One quantity in which two runs differ."""

    column: str
    """Its name."""
    stage: str
    """Step of the control tick that produces it."""
    first_tick: int
    """First tick at which it differs by more than allowed."""
    first_time_s: float
    """The same in seconds of the run."""
    ticks: int
    """How many of the compared ticks differ."""
    largest: float | None
    """Largest difference in its unit (for times to collision 1/s); None for names and indices."""
    largest_tick: int
    """Where that is."""
    entry: int | None
    """Which entry of a vector it is."""
    run: str
    """What the run has there."""
    reference: str
    """What the reference has there."""


@dataclass(frozen=True)
class Agreement:
    """Run and reference in one quantity, row by row."""

    excess: NDArray[np.float64]
    """(R,) or (R, n): how far the run is from the reference, infinite where only one is null."""
    differs: NDArray[np.bool_]
    """Same shape: whether that is more than allowed."""
    run: NDArray[Any]
    """What the run has."""
    reference: NDArray[Any]
    """What the reference has."""

    def without(self, rows: NDArray[np.bool_]) -> Agreement:
        """The same, with some rows passed over."""
        apart = rows if self.differs.ndim == 1 else rows[:, None]
        return replace(self, differs=self.differs & ~apart)

    def excused(self, tied: NDArray[np.bool_]) -> Agreement:
        """Another pair that is tied with the reference's is no difference."""
        fine = np.zeros(len(self.run), dtype=bool)
        known = self.run >= 0
        fine[known] = tied[np.flatnonzero(known), self.run[known].astype(np.intp)]
        return self.without(fine)

    def difference(
        self, name: str, column: Column, ticks: NDArray[np.int64], period_s: float
    ) -> Difference | None:
        """The line for this quantity; None if the two agree."""
        by_row = self.differs if self.differs.ndim == 1 else self.differs.any(axis=1)
        where = np.flatnonzero(by_row)
        if not len(where):
            return None
        excess = np.where(self.differs, self.excess, -1.0)
        peak = np.unravel_index(int(np.argmax(excess)), excess.shape)
        number = column.signal.dtype == "float64"
        return Difference(
            column=name,
            stage=column.signal.stage,
            first_tick=int(ticks[where[0]]),
            first_time_s=float(ticks[where[0]] * period_s),
            ticks=len(where),
            largest=float(excess[peak]) if number else None,
            largest_tick=int(ticks[peak[0]]),
            entry=int(peak[1]) if len(peak) > 1 else None,
            run=_shown(self.run[peak]),
            reference=_shown(self.reference[peak]),
        )


def hold_against(
    column: Column,
    run: NDArray[Any],
    reference: NDArray[Any],
    rows: NDArray[np.intp],
    widen: float,
    slack_ticks: int,
    without_plant: bool,
) -> Agreement:
    """Hold a run's values against a reference's; with slack, against the nearest within so many ticks."""
    signal = column.signal
    if without_plant and signal.name == "reason":
        run, reference = (np.where(x == PLANT_REASON, "", x) for x in (run, reference))
    window = [
        np.clip(rows + shift, 0, len(run) - 1) for shift in range(-slack_ticks, slack_ticks + 1)
    ]
    if signal.dtype != "float64":
        differs = np.all([run[shifted] != reference for shifted in window], axis=0)
        return Agreement(differs.astype(float), differs, run[rows], reference)
    a, b = run, reference
    if signal.name in TTC_SIGNALS:
        a, b = reciprocal(run), reciprocal(reference)
    seen = np.stack([a[shifted] for shifted in window])
    if signal.shape == "wxyz":
        seen = np.where((seen * b).sum(axis=-1, keepdims=True) < 0.0, -seen, seen)
    # Between the smallest and the largest of the window lies whatever a step a tick late can pass.
    # Where every value of the window is null, `fmin` of nulls is null.
    low, high = np.fmin.reduce(seen), np.fmax.reduce(seen)
    none_run, none_reference = np.isnan(seen), np.isnan(b)
    with np.errstate(invalid="ignore"):
        excess = np.fmax(np.fmax(low - b, b - high), 0.0)
    excess = np.where(np.isnan(excess), np.inf, excess)
    agree_on_none = np.where(none_reference, none_run.any(axis=0), ~none_run.all(axis=0))
    excess = np.where(agree_on_none, np.where(none_reference, 0.0, excess), np.inf)
    allowed = widen * (signal.atol + signal.rtol * np.abs(np.where(none_reference, 0.0, b)))
    return Agreement(excess, excess > allowed, run[rows], reference)


def reciprocal(ttc_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """1/s, 0 where there is no collision ahead; a time of 0 counts as the shortest a float holds."""
    return np.where(np.isnan(ttc_s), 0.0, 1.0 / np.maximum(ttc_s, np.finfo(float).tiny * 4))


def _shown(value: Any) -> str:
    if isinstance(value, (float, np.floating)):
        return "null" if np.isnan(value) else f"{value:.9g}"
    if isinstance(value, (int, np.integer)):
        return "null" if value < 0 else str(value)
    return repr(str(value))
