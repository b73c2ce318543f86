"""A recorded operator: a file of times and tool poses -> the motion wanted at any time.

The file (CSV or parquet) has the columns time_s, x_m, y_m, z_m, qw, qx, qy, qz in the world frame, at
any rate, and may have the twist vx_m_s .. wz_rad_s too. Between samples the position is linear and
the orientation a slerp; at a sample that falls on a tick it is the sample itself, to the last bit.
What cannot be followed is refused on load with row and column; gaps and jumps are handled by the
rules in docs/teleop.md: stand still over a gap, cross a jump at limited speed.
"""

from __future__ import annotations

import csv
from bisect import bisect_right
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from workcell import scenario
from workcell.errors import InputError
from workcell.motion.operators.samples import HAND_SPEED_M_S, HAND_TURN_RAD_S
from workcell.motion.orientation import rotation_between, turned
from workcell.motion.path import Target, length, standing
from workcell.motion.reference_governor import Caps, ReferenceGovernor
from workcell.motion.setpoint import ENDED, GAP, JUMP, VALID, WAITING, Setpoint

POSE_COLUMNS = ("time_s", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")
"""Columns a recording must have."""
TWIST_COLUMNS = ("vx_m_s", "vy_m_s", "vz_m_s", "wx_rad_s", "wy_rad_s", "wz_rad_s")
"""Columns it may have, all or none; without them the twist is that of the way between two samples."""
UNIT_TOLERANCE = scenario.UNIT_QUATERNION_TOLERANCE
"""How far the norm of a quaternion may be off 1; it is then normalised."""
_EXACT = 1e-12
"""A quaternion this near to length 1 is left as it is, so that a replay is exact to the last bit."""
_FAULTS_SHOWN = 10


@dataclass(frozen=True)
class Samples:
    """The content of a recording; n samples."""

    time_s: NDArray[np.float64]
    """(n,) rising."""
    position_m: NDArray[np.float64]
    """(n, 3)"""
    wxyz: NDArray[np.float64]
    """(n, 4) unit quaternions"""
    twist: NDArray[np.float64] | None
    """(n, 6) velocity in m/s, angular velocity in rad/s, both in the world; None if not recorded."""


def read(path: Path | str) -> Samples:
    """Read and check a recording.

    Raises:
        InputError: the file is missing or not a table, lacks a column, or holds a row that cannot be
            followed; each fault names row (counted from 1, without the header), column and value.
    """
    path = Path(path)
    table = _table(path)
    missing = [name for name in POSE_COLUMNS if name not in table]
    twisted = [name for name in TWIST_COLUMNS if name in table]
    faults = [
        f"column {name}: is missing; needed are {', '.join(POSE_COLUMNS)}" for name in missing
    ]
    if twisted and len(twisted) < len(TWIST_COLUMNS):
        faults += [
            f"column {name}: is missing; the twist is {', '.join(TWIST_COLUMNS)}, all or none"
            for name in TWIST_COLUMNS
            if name not in table
        ]
    if faults:
        raise InputError(faults, file=path)
    names = POSE_COLUMNS + (TWIST_COLUMNS if twisted else ())
    values = np.column_stack([table[name] for name in names])
    if len(values) < 1:
        raise InputError("has no samples; at least one is needed", file=path)
    faults = [
        f"row {row + 1}, column {names[column]} = {values[row, column]}: is not finite"
        for row, column in np.argwhere(~np.isfinite(values))
    ]
    finite = np.asarray(np.isfinite(values).all(axis=1))
    time_s, quaternion = values[:, 0], values[:, 4:8]
    faults += [
        f"row {row + 2}, column time_s = {time_s[row + 1]:.9g}: is not later than {time_s[row]:.9g} in the row before; times must rise"
        for row in np.flatnonzero((np.diff(time_s) <= 0) & finite[1:] & finite[:-1])
    ]
    if finite[0] and time_s[0] < 0:
        faults.append(
            f"row 1, column time_s = {time_s[0]:.9g}: is negative; allowed is 0 or more, time of the run"
        )
    norm = np.linalg.norm(quaternion, axis=1)
    faults += [
        f"row {row + 1}, columns qw qx qy qz: have norm {norm[row]:.6g}; allowed is 1 within {UNIT_TOLERANCE:g}"
        for row in np.flatnonzero((np.abs(norm - 1.0) > UNIT_TOLERANCE) & finite)
    ]
    if faults:
        more = [f"and {len(faults) - _FAULTS_SHOWN} more"] if len(faults) > _FAULTS_SHOWN else []
        raise InputError(faults[:_FAULTS_SHOWN] + more, file=path)
    rounded = np.abs(norm - 1.0) > _EXACT
    quaternion = np.where(rounded[:, None], quaternion / norm[:, None], quaternion)
    return Samples(time_s, values[:, 1:4], quaternion, values[:, 8:] if twisted else None)


def write(path: Path | str, samples: Samples) -> Path:
    """Write a recording as CSV with numbers that read back to the same bits.

    Returns:
        The path written.
    """
    path = Path(path)
    names = POSE_COLUMNS + (() if samples.twist is None else TWIST_COLUMNS)
    parts = [samples.time_s[:, None], samples.position_m, samples.wxyz]
    if samples.twist is not None:
        parts.append(samples.twist)
    with path.open("w", newline="", encoding="utf-8") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(names)
        # repr gives the shortest text that reads back to the same number.
        out.writerows([repr(x) for x in row] for row in np.hstack(parts).tolist())
    return path


class RecordingOperator:
    """Follows a recording, from the start pose on, through the reference governor.

    Raises:
        InputError: see `read`.
    """

    def __init__(
        self,
        settings: scenario.Recording,
        position_m: NDArray[np.float64],
        wxyz: NDArray[np.float64],
        *,
        period_s: float,
    ):
        self._samples = read(settings.file)
        self._times: list[float] = self._samples.time_s.tolist()
        self._settings = settings
        self._start = standing(position_m, wxyz)
        # Half a tick: a sample written at a tick is found again whatever the last digit of its time.
        self._at_sample_s = 1e-6 * period_s
        caps = Caps(
            settings.max_speed_m_s,
            settings.max_acceleration_m_s2,
            settings.max_turn_rad_s,
            settings.max_turn_rad_s2,
        )
        self._governor = ReferenceGovernor(caps, position_m, wxyz, period_s=period_s)

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
            return here, ENDED
        if exact and samples.twist is not None:
            return (
                Target(here.position_m, here.wxyz, samples.twist[k, :3], samples.twist[k, 3:]),
                VALID,
            )
        if k == len(times) - 1:
            return here, VALID
        step_s = times[k + 1] - times[k]
        way = samples.position_m[k + 1] - samples.position_m[k]
        turn = rotation_between(samples.wxyz[k], samples.wxyz[k + 1])
        if step_s > settings.gap_s:
            return here, VALID if exact else GAP
        leap_m = settings.jump_m + HAND_SPEED_M_S * step_s
        leap_rad = settings.jump_rad + HAND_TURN_RAD_S * step_s
        if length(way) > leap_m or length(turn) > leap_rad:
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


def _table(path: Path) -> dict[str, NDArray[np.float64]]:
    """The columns of a file by name, as numbers."""
    if not path.is_file():
        raise InputError("no such recording; allowed is a .csv or .parquet file", file=path)
    if path.suffix == ".parquet":
        try:
            table = pq.read_table(path)
        except (pa.ArrowException, OSError) as error:
            raise InputError(f"is not a readable parquet file: {error}", file=path) from error
        faults = [
            f"column {field.name}: is of type {field.type}; a number is needed"
            for field in table.schema
            if field.name in POSE_COLUMNS + TWIST_COLUMNS
            and not (pa.types.is_floating(field.type) or pa.types.is_integer(field.type))
        ]
        if faults:
            raise InputError(faults, file=path)
        return {
            # A null becomes NaN here and is refused as such, with its row.
            name: table[name].to_numpy(zero_copy_only=False).astype(float)
            for name in table.column_names
            if name in POSE_COLUMNS + TWIST_COLUMNS
        }
    if path.suffix != ".csv":
        raise InputError(
            f"ends in {path.suffix or 'nothing'!r}; allowed is a .csv or .parquet file", file=path
        )
    return _csv_table(path)


def _csv_table(path: Path) -> dict[str, NDArray[np.float64]]:
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            header, *rows = list(csv.reader(file)) or [[]]
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"is not a readable CSV file: {error}", file=path) from error
    header = [name.strip() for name in header]
    doubled = sorted({name for name in header if header.count(name) > 1})
    faults = [f"column {name}: occurs more than once" for name in doubled]
    columns: dict[str, list[float]] = {
        name: [] for name in header if name in POSE_COLUMNS + TWIST_COLUMNS
    }
    for number, row in enumerate(rows, start=1):
        if not row:  # an empty line, as some programs leave at the end
            continue
        if len(row) != len(header):
            faults.append(f"row {number}: has {len(row)} entries, the header has {len(header)}")
            continue
        for name, text in zip(header, row, strict=True):
            if name not in columns:
                continue
            try:
                columns[name].append(float(text))
            except ValueError:
                faults.append(f"row {number}, column {name} = {text!r}: is not a number")
    if faults:
        more = [f"and {len(faults) - _FAULTS_SHOWN} more"] if len(faults) > _FAULTS_SHOWN else []
        raise InputError(faults[:_FAULTS_SHOWN] + more, file=path)
    return {name: np.array(values) for name, values in columns.items()}
