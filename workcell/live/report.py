"""What a person who has driven wants to know at the end: how near it came, who waited, how even the hand was."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workcell.live.latency import InputLatency
from workcell.live.marker import SHORT_M
from workcell.live.status import STANDING_SCALE
from workcell.motion.setpoint import CATCHING_UP, VALID, WAITING
from workcell.trace.table import Trace

MOVING_M_S = 0.02
"""A tool faster than this is in motion."""
MOVEMENT_S = 0.4
"""Shorter motions are too short to be called even or uneven."""
EVEN = -2.5
"""Spectral arc length above which a motion is called even; a minimum-jerk reach has -1.4, a stop in the middle -2.5 or less."""
_CUT_HZ = 10.0
_LEVEL = 0.05
"""Spectral arc length counts up to the last frequency below 10 Hz at which the speed's spectrum has a twentieth of
its top (Balasubramanian, Melendez-Calderon and Burdet, 2012)."""


@dataclass(frozen=True)
class Nearest:
    """The smallest distance of a session."""

    distance_m: float
    time_s: float
    pair: str


@dataclass(frozen=True)
class Wait:
    """Time that a support arm stood or gave way for one reason."""

    arm: str
    time_s: float
    why: str


@dataclass(frozen=True)
class Fault:
    """Of an input stream."""

    arm: str
    state: str
    times: int
    time_s: float


@dataclass(frozen=True)
class Reach:
    """How far a driven tool was kept from where it was wanted."""

    arm: str
    farthest_m: float
    time_s: float
    """Time beyond `SHORT_M`."""


@dataclass(frozen=True)
class Motion:
    """How even a driven tool moved."""

    arm: str
    movements: int
    spectral_arc_length: float | None
    """Median over the movements; nearer to zero is more even. None without a movement."""


@dataclass(frozen=True)
class OperatorReport:
    """What happened in one live run, for the person who drove."""

    duration_s: float
    nearest: Nearest | None
    waits: tuple[Wait, ...]
    """Longest first."""
    faults: tuple[Fault, ...]
    reaches: tuple[Reach, ...]
    motions: tuple[Motion, ...]
    latency: InputLatency
    stopped: str
    """Why the final check stopped the support arms last; empty if it did not."""

    def as_json(self) -> dict[str, Any]:
        """For summary.json."""
        return asdict(self)

    def lines(self) -> list[str]:
        """The same in sentences."""
        lines = [f"You drove for {self.duration_s:.1f} s."]
        if self.nearest is not None:
            n = self.nearest
            lines.append(f"Nearest: {1e3 * n.distance_m:.0f} mm at {n.time_s:.1f} s, {n.pair}.")
        if self.stopped:
            lines.append(f"The final check stopped the support arms: {self.stopped}.")
        for wait in self.waits:
            lines.append(f"{wait.arm} waited or gave way for {wait.time_s:.1f} s: {wait.why}.")
        if not self.waits:
            lines.append("Nobody had to wait for you.")
        for fault in self.faults:
            lines.append(
                f"Input of {fault.arm}: {fault.state.replace('_', ' ')} {fault.times} times, {fault.time_s:.1f} s in all."
            )
        for reach in self.reaches:
            if reach.time_s > 0.0:
                lines.append(
                    f"{reach.arm} was up to {1e2 * reach.farthest_m:.0f} cm short of where you wanted it, for {reach.time_s:.1f} s."
                )
        for motion in self.motions:
            if motion.spectral_arc_length is not None:
                even = "even" if motion.spectral_arc_length > EVEN else "uneven"
                lines.append(
                    f"{motion.movements} movements of {motion.arm}, {even} (spectral arc length {motion.spectral_arc_length:.1f})."
                )
        if self.latency.median_s is not None and self.latency.p99_s is not None:
            lines.append(
                f"From input to motion: {1e3 * self.latency.median_s:.0f} ms, 99 % within {1e3 * self.latency.p99_s:.0f} ms ({self.latency.count} inputs)."
            )
        return lines


def operator_report(
    trace: Trace, *, live: list[str], latency: InputLatency, stopped: str = ""
) -> OperatorReport:
    """Sum up a live run.

    Args:
        trace: Of the run.
        live: Arms that a person drove.
        latency: From input to motion.
        stopped: Why the final check stopped the support arms, empty if it did not.
    """
    period_s = float(trace.metadata["settings"]["simulation"]["period_s"])
    support = [arm for arm in trace.metadata["arms"] if arm not in live]
    return OperatorReport(
        duration_s=len(trace) * period_s,
        nearest=_nearest(trace),
        waits=tuple(wait for arm in support for wait in _waits(trace, arm, period_s)),
        faults=tuple(fault for arm in live for fault in _faults(trace, arm, period_s)),
        reaches=tuple(_reach(trace, arm, period_s) for arm in live),
        motions=tuple(_motion(trace, arm, period_s) for arm in live),
        latency=latency,
        stopped=stopped,
    )


def _nearest(trace: Trace) -> Nearest | None:
    """Over the pairs that are not brought together on purpose."""
    pairs = trace.metadata["pairs"]
    meeting = {tuple(pair) for pair in trace.metadata["meeting_pairs"]}
    counted = [k for k, pair in enumerate(pairs) if tuple(pair) not in meeting]
    if not len(trace) or not counted:
        return None
    distance = np.asarray(trace["pair_distance_m"])[:, counted]
    tick, column = np.unravel_index(int(np.argmin(distance)), distance.shape)
    return Nearest(
        float(distance[tick, column]),
        float(trace["time_s"][tick]),
        " – ".join(_words(name) for name in pairs[counted[column]]),
    )


def _waits(trace: Trace, arm: str, period_s: float) -> list[Wait]:
    """Ticks in which an arm with something to do stood or gave way, by what limited it."""
    job, mode = trace[f"{arm}.job"], trace[f"{arm}.mode"]
    scale, reason = np.abs(trace[f"{arm}.scale"]), trace[f"{arm}.reason"]
    idle = np.isin(job, ("wait", "done", "dwell"))
    stands = ~idle & ((scale < STANDING_SCALE) | np.isin(mode, ("yield", "hold", "halt")))
    ticks: dict[str, int] = {}
    pair = trace[f"{arm}.limiting_pair"]
    for k in np.flatnonzero(stands):
        why = _why(trace, arm, str(mode[k]), str(reason[k]), pair[k])
        ticks[why] = ticks.get(why, 0) + 1
    return [
        Wait(arm, count * period_s, why)
        for why, count in sorted(ticks.items(), key=lambda item: -item[1])
    ]


def _why(trace: Trace, arm: str, mode: str, reason: str, pair: Any) -> str:
    if reason == "check":
        return "the final check had stopped it"
    if mode == "hold":
        return "it found no way past"
    if pair is None or not np.isfinite(pair) or pair < 0:
        return "the others came too near"
    names = trace.metadata["pairs"][int(pair)]
    other = next((name for name in names if not name.startswith(f"{arm}/")), names[0])
    return f"{_words(other)} came" if mode == "yield" else f"{_words(other)} was in its way"


def _faults(trace: Trace, arm: str, period_s: float) -> list[Fault]:
    state = trace[f"{arm}.operator_state"]
    found = []
    for name in sorted(set(state.tolist()) - {VALID, WAITING, CATCHING_UP}):
        is_so = state == name
        times = int(np.count_nonzero(np.diff(is_so.astype(int), prepend=0) == 1))
        found.append(Fault(arm, str(name), times, float(is_so.sum()) * period_s))
    return found


def _reach(trace: Trace, arm: str, period_s: float) -> Reach:
    error = trace[f"{arm}.tool_error_m"]
    short = error > SHORT_M
    return Reach(arm, float(error.max(initial=0.0)), float(short.sum()) * period_s)


def _motion(trace: Trace, arm: str, period_s: float) -> Motion:
    speed = trace[f"{arm}.tool_speed_m_s"]
    lengths = [
        spectral_arc_length(speed[first:last], period_s)
        for first, last in _spans(speed > MOVING_M_S)
        if (last - first) * period_s >= MOVEMENT_S
    ]
    return Motion(arm, len(lengths), float(np.median(lengths)) if lengths else None)


def _spans(is_so: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First index and the one after the last of every stretch of True."""
    edges = np.flatnonzero(np.diff(is_so.astype(int), prepend=0, append=0))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def spectral_arc_length(speed_m_s: NDArray[np.float64], period_s: float) -> float:
    """Evenness of a motion: minus the arc length of its speed's normalised spectrum.

    Args:
        speed_m_s: (n,) from rest to rest, n >= 2.
        period_s: Between two of them.

    Returns:
        -sum sqrt((Δf/f_c)² + (ΔV)²) up to the cut-off f_c; about -1.4 for a minimum-jerk reach.
    """
    count = 1 << (len(speed_m_s) - 1).bit_length() + 4
    spectrum = np.abs(np.fft.rfft(speed_m_s, count))
    frequency = np.fft.rfftfreq(count, period_s)
    height = spectrum / spectrum.max()
    within = np.flatnonzero((frequency <= _CUT_HZ) & (height >= _LEVEL))
    last = max(int(within[-1]), 1)
    steps = np.diff(frequency[: last + 1]) / frequency[last]
    return -float(np.hypot(steps, np.diff(height[: last + 1])).sum())


def _words(geom: str) -> str:
    owner, slash, part = geom.rpartition("/")
    part = part.removesuffix("_capsule").replace("_", " ")
    return f"{part} of the {owner}" if slash else f"the {part}"
