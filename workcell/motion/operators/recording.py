"""A recorded operator: the samples of a file -> the motion wanted at any time.

Between samples the position is linear and the orientation a slerp; at a sample that falls on a tick
it is the sample itself, to the last bit. Gaps and jumps are handled by the rules in docs/teleop.md:
the arm stands over a gap, and a jump that is believed is crossed at limited speed. `faults` says
before a run what no rule can mend.
"""

from __future__ import annotations

from bisect import bisect_right

import numpy as np
from numpy.typing import NDArray

from workcell import scenario
from workcell.errors import InputError
from workcell.motion.operators.recording_file import Samples, read
from workcell.motion.operators.samples import (
    HAND_SPEED_M_S,
    HAND_TURN_RAD_S,
    JumpRule,
    Sample,
)
from workcell.motion.orientation import rotation_between, turned
from workcell.motion.path import Target, length, standing
from workcell.motion.reference_governor import Caps, ReferenceGovernor
from workcell.motion.setpoint import ENDED, GAP, JUMP, VALID, WAITING, Setpoint


def faults(
    settings: scenario.Recording,
    position_m: NDArray[np.float64],
    wxyz: NDArray[np.float64],
    *,
    duration_s: float,
    period_s: float,
) -> list[str]:
    """Why a recording cannot drive an arm through a run; empty where it can.

    Args:
        settings: From the scenario.
        position_m, wxyz: Tool pose at the start.
        duration_s: Length of the run.
        period_s: Control period.

    Returns:
        One sentence for each fault, with the key, its value and what is allowed.
    """
    try:
        samples = read(settings.file)
    except InputError as error:
        return [f"file = {settings.file!r}: {fault}" for fault in error.faults]
    where = f"file = {settings.file!r}"
    found = _time_faults(settings, samples.time_s, duration_s, period_s)
    way_m = length(samples.position_m[0] - position_m)
    turn_rad = length(rotation_between(np.asarray(wxyz, dtype=float), samples.wxyz[0]))
    if way_m > settings.jump_m:
        found.append(
            f"row 1 is {way_m:.3g} m from the tool's start; allowed is jump_m = {settings.jump_m:g} m: "
            "begin where the tool stands, or raise jump_m"
        )
    if turn_rad > settings.jump_rad:
        found.append(
            f"row 1 is turned by {turn_rad:.3g} rad from the tool's start; allowed is jump_rad = "
            f"{settings.jump_rad:g} rad: begin where the tool stands, or raise jump_rad"
        )
    return [f"{where}: {fault}" for fault in found]


def _time_faults(
    settings: scenario.Recording, time_s: NDArray[np.float64], duration_s: float, period_s: float
) -> list[str]:
    """Times on another clock than the run's, or too far apart to be followed."""
    run = f"the run ends at {duration_s:g} s; time_s counts seconds from the start of the run"
    last_tick_s = duration_s - period_s
    if last_tick_s <= 0.0:  # a run of one tick has no motion to miss
        last_tick_s = duration_s
    start_s = time_s + settings.start_s
    shift = f" with start_s = {settings.start_s:g}" if settings.start_s else ""
    if start_s[0] > last_tick_s + 0.5 * period_s:
        return [f"row 1, column time_s = {float(time_s[0])!r}{shift}: lies after the end; {run}"]
    if duration_s <= 1.5 * period_s:
        return []
    if len(time_s) == 1:
        return ["has one sample; a motion needs two or more"]
    if start_s[1] > last_tick_s + 0.5 * period_s:
        return [
            f"row 2, column time_s = {float(time_s[1])!r}{shift}: only the first sample lies within the run; {run}"
        ]
    within = np.diff(time_s)[start_s[1:] <= duration_s]
    if within.min() > settings.gap_s:
        return [
            f"its samples are {within.min():.3g} s apart or more, each a gap; allowed is gap_s = {settings.gap_s:g} s: "
            "give time_s in seconds, or raise gap_s"
        ]
    return []


class RecordingOperator:
    """Follows a recording, from the start pose on, through the reference governor.

    Raises:
        InputError: see `recording_file.read`.
    """

    def __init__(
        self,
        settings: scenario.Recording,
        position_m: NDArray[np.float64],
        wxyz: NDArray[np.float64],
        *,
        period_s: float,
    ):
        samples = read(settings.file)
        believed = believed_samples(samples, settings)
        self._jumped = np.diff(believed) > 1
        """(n - 1,) whether samples were left out between two that are believed."""
        self._samples = Samples(
            samples.time_s[believed],
            samples.position_m[believed],
            samples.wxyz[believed],
            None if samples.twist is None else samples.twist[believed],
        )
        self._times: list[float] = self._samples.time_s.tolist()
        self._last_s = float(samples.time_s[-1])
        """Time of the last sample, believed or not."""
        self._settings = settings
        self._start = standing(position_m, wxyz)
        # Half a tick: a sample written at a tick is found again whatever the last digit of its time.
        self._at_sample_s = 1e-6 * period_s
        self._governor = ReferenceGovernor(Caps.of(settings), position_m, wxyz, period_s=period_s)

    def setpoint(self, time_s: float) -> Setpoint:
        wanted, state = self._wanted(time_s - self._settings.start_s)
        target, state = self._governor.follow(wanted, state)
        return Setpoint(target, "recording", state)

    def _wanted(self, time_s: float) -> tuple[Target, str]:
        """The recording's own pose and twist at a time, and what is wrong with it there."""
        samples, times, settings = self._samples, self._times, self._settings
        if time_s < times[0] - self._at_sample_s:
            return self._start, WAITING
        k = bisect_right(times, time_s + self._at_sample_s) - 1
        here = standing(samples.position_m[k], samples.wxyz[k])
        exact = time_s - times[k] <= self._at_sample_s
        if k == len(times) - 1 and not exact:
            return here, JUMP if time_s <= self._last_s else ENDED
        if exact and samples.twist is not None:
            return (
                Target(here.position_m, here.wxyz, samples.twist[k, :3], samples.twist[k, 3:]),
                VALID,
            )
        if k == len(times) - 1:
            return here, VALID
        step_s = times[k + 1] - times[k]
        if self._jumped[k]:
            return here, VALID if exact else JUMP
        if step_s > settings.gap_s:
            return here, VALID if exact else GAP
        way = samples.position_m[k + 1] - samples.position_m[k]
        turn = rotation_between(samples.wxyz[k], samples.wxyz[k + 1])
        if length(way) > settings.jump_m + HAND_SPEED_M_S * step_s or (
            length(turn) > settings.jump_rad + HAND_TURN_RAD_S * step_s
        ):
            # Believed at once, with jump_confirm_s = 0; the target still does not leap.
            return here, VALID if exact else JUMP
        part = 0.0 if exact else (time_s - times[k]) / step_s
        if samples.twist is None:
            velocity, spin = way / step_s, turn / step_s
        else:
            twist = (1 - part) * samples.twist[k] + part * samples.twist[k + 1]
            velocity, spin = twist[:3], twist[3:]
        return (
            Target(
                here.position_m + part * way,
                here.wxyz if exact else turned(here.wxyz, part * turn),
                velocity,
                spin,
            ),
            VALID,
        )


def believed_samples(samples: Samples, settings: scenario.Recording) -> NDArray[np.intp]:
    """(m,) which samples of a recording are believed: the rule of live streams (`JumpRule`), sample by sample."""
    time_s, position, wxyz = samples.time_s, samples.position_m, samples.wxyz
    step_s = np.diff(time_s)
    way = np.linalg.norm(np.diff(position, axis=0), axis=1)
    # |q - q'| is 2 sin(angle / 4) of the turn between them, the sign of one chosen as the nearer.
    near = np.minimum(
        np.linalg.norm(wxyz[1:] - wxyz[:-1], axis=1), np.linalg.norm(wxyz[1:] + wxyz[:-1], axis=1)
    )
    turn = 4.0 * np.arcsin(np.minimum(near / 2.0, 1.0))
    # Steps that are surely no jump need not be asked for one by one.
    suspect = (way > 0.99 * (settings.jump_m + HAND_SPEED_M_S * step_s)) | (
        turn > 0.99 * (settings.jump_rad + HAND_TURN_RAD_S * step_s)
    )
    believed = np.ones(len(time_s), dtype=bool)
    rule = JumpRule(settings)
    settled = 0
    for first in (np.flatnonzero(suspect) + 1).tolist():
        if first < settled:
            continue
        good = _sample(samples, first - 1)
        for k in range(first, len(time_s)):
            believed[k] = rule.believes(
                good, _sample(samples, k), passed_s=float(time_s[k] - time_s[k - 1])
            )
            if believed[k]:
                settled = k + 1
                break
        else:
            break
    return np.flatnonzero(believed)


def _sample(samples: Samples, k: int) -> Sample:
    return Sample(float(samples.time_s[k]), samples.position_m[k], samples.wxyz[k])
