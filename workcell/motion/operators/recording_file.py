"""The file of a recorded operator: a table of times and tool poses, read and checked, or written.

CSV or parquet, with the columns time_s, x_m, y_m, z_m, qw, qx, qy, qz in the world frame, at any
rate; the twist vx_m_s .. wz_rad_s may be there too. What cannot be followed is refused with row and
column. Rows are counted from 1, without the header and without empty lines. A recording that this
program writes says its format in a column of its own; one that says none is of the first format.
"""

from __future__ import annotations

import csv
from array import array
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from workcell import scenario
from workcell.errors import InputError
from workcell.motion.operators.samples import LARGEST_M

FORMAT = 1
"""Version of the table; raised when a column changes its meaning, so that an older program does not misread it."""
FORMAT_COLUMN = "recording_format"
"""Column with the version in every row, so that any program reads the file as a plain table."""
POSE_COLUMNS = ("time_s", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")
"""Columns a recording must have."""
TWIST_COLUMNS = ("vx_m_s", "vy_m_s", "vz_m_s", "wx_rad_s", "wy_rad_s", "wz_rad_s")
"""Columns it may have, all or none; without them the twist is that of the way between two samples."""
UNIT_TOLERANCE = scenario.UNIT_QUATERNION_TOLERANCE
"""How far the norm of a quaternion may be off 1; it is then normalised."""
LARGEST_FILE_BYTES = 256_000_000
LARGEST_ROWS = 4_000_000
"""More is refused before it is read: two hours at 500 Hz fit, and memory stays below 1 GB."""
LARGEST_TWIST = 1000.0
"""A velocity (m/s, rad/s) beyond this is no motion of a tool: chosen far beyond any, and far below where arithmetic overflows."""
_EXACT = 1e-12
"""A quaternion this near to length 1 is left as it is, so that a replay is exact to the last bit."""
_FAULTS_SHOWN = 5
_NAMES_SHOWN = 10


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
            followed; each fault names row, column and value.
    """
    path = Path(path)
    table = _table(path)
    twisted = any(name in table for name in TWIST_COLUMNS)
    names = POSE_COLUMNS + (TWIST_COLUMNS if twisted else ())
    values = np.column_stack([table[name] for name in names])
    if len(values) < 1:
        raise InputError("has no samples; at least one is needed", file=path)
    faults = list(_number_faults(names, values))
    sound = np.isfinite(values).all(axis=1)
    sound &= np.all(np.abs(values[:, 1:]) <= _largest(names)[1:], axis=1)
    time_s, quaternion = values[:, 0], values[:, 4:8]
    with np.errstate(invalid="ignore", over="ignore"):
        falls = (np.diff(time_s) <= 0) & np.isfinite(time_s[1:]) & np.isfinite(time_s[:-1])
    faults += [
        f"row {row + 2}, column time_s = {float(time_s[row + 1])!r}: is not later than {float(time_s[row])!r} in the row before; times must rise"
        for row in np.flatnonzero(falls)
    ]
    if np.isfinite(time_s[0]) and time_s[0] < 0:
        faults.append(
            f"row 1, column time_s = {float(time_s[0])!r}: is negative; allowed is 0 or more, time of the run"
        )
    norm = np.linalg.norm(np.where(sound[:, None], quaternion, 0.5), axis=1)
    faults += [
        f"row {row + 1}, columns qw qx qy qz: have norm {norm[row]:.6g}; allowed is 1 within {UNIT_TOLERANCE:g}"
        for row in np.flatnonzero(np.abs(norm - 1.0) > UNIT_TOLERANCE)
    ]
    _refuse(faults, path)
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
        out.writerow([*names, FORMAT_COLUMN])
        # repr gives the shortest text that reads back to the same number.
        out.writerows([*map(repr, row), FORMAT] for row in np.hstack(parts).tolist())
    return path


def _check_format(said: object, path: Path) -> None:
    """Refuse a format that this program does not know, by what the first row says."""
    text = str(said).strip().removesuffix(".0")
    version = int(text) if text.isascii() and text.isdecimal() and len(text) < 10 else 0
    where = f"row 1, column {FORMAT_COLUMN} = {text[:40]}"
    if version > FORMAT:
        raise InputError(
            f"{where}: is newer than this program, which reads formats up to {FORMAT}: update workcell",
            file=path,
        )
    if version < 1:
        raise InputError(f"{where}: is no format; allowed are 1 to {FORMAT}", file=path)


def _largest(names: Iterable[str]) -> NDArray[np.float64]:
    """Largest magnitude allowed, by column; times are bounded by their order and by the run."""
    bounds = {"time_s": np.inf, "x_m": LARGEST_M, "y_m": LARGEST_M, "z_m": LARGEST_M}
    return np.array(
        [bounds.get(name, LARGEST_TWIST if name in TWIST_COLUMNS else 10.0) for name in names]
    )


def _number_faults(names: tuple[str, ...], values: NDArray[np.float64]) -> Iterable[str]:
    """Entries that are not finite, or larger than their column can mean."""
    for row, column in np.argwhere(~np.isfinite(values)):
        yield f"row {row + 1}, column {names[column]} = {values[row, column]}: is not finite"
    largest = _largest(names)
    for row, column in np.argwhere(np.isfinite(values) & (np.abs(values) > largest)):
        yield (
            f"row {row + 1}, column {names[column]} = {values[row, column]:.9g}: "
            f"allowed is a magnitude of {largest[column]:g} at most"
        )


def _refuse(faults: list[str], path: Path) -> None:
    """Raise what was found, if anything was."""
    if faults:
        more = [f"and {len(faults) - _FAULTS_SHOWN} more"] if len(faults) > _FAULTS_SHOWN else []
        raise InputError(faults[:_FAULTS_SHOWN] + more, file=path)


def _missing(found: Iterable[str]) -> list[str]:
    """What is wrong with the names of a table's columns."""
    names = list(found)
    doubled = sorted({name for name in names if names.count(name) > 1})
    faults = [
        f"column {name}: occurs more than once"
        for name in doubled
        if name in POSE_COLUMNS + TWIST_COLUMNS
    ]
    absent = [name for name in POSE_COLUMNS if name not in names]
    if absent:
        has = ", ".join(names[:_NAMES_SHOWN]) + (", ..." if len(names) > _NAMES_SHOWN else "")
        faults.append(
            f"{_are_missing(absent)}; needed are {', '.join(POSE_COLUMNS)}; the file has {has[:400] or 'no columns'}"
        )
    no_twist = [name for name in TWIST_COLUMNS if name not in names]
    if 0 < len(no_twist) < len(TWIST_COLUMNS):
        faults.append(
            f"{_are_missing(no_twist)}; the twist is {', '.join(TWIST_COLUMNS)}, all or none"
        )
    return faults


def _are_missing(names: list[str]) -> str:
    return (
        f"column {names[0]}: is missing"
        if len(names) == 1
        else f"columns {', '.join(names)}: are missing"
    )


def _table(path: Path) -> dict[str, NDArray[np.float64]]:
    """The columns of a file by name, as numbers."""
    if path.suffix not in (".csv", ".parquet"):
        if not path.is_file():
            raise InputError("no such recording; allowed is a .csv or .parquet file", file=path)
        raise InputError(
            f"ends in {path.suffix or 'nothing'!r}; allowed is a .csv or .parquet file", file=path
        )
    try:
        if not path.is_file():
            raise InputError("no such recording; allowed is a .csv or .parquet file", file=path)
        size = path.stat().st_size
        if size > LARGEST_FILE_BYTES:
            raise InputError(
                f"is {size / 1e6:.0f} MB; allowed are {LARGEST_FILE_BYTES / 1e6:.0f} MB at most",
                file=path,
            )
        return _parquet_table(path) if path.suffix == ".parquet" else _csv_table(path)
    except (pa.ArrowException, OSError) as error:
        kind = "parquet" if path.suffix == ".parquet" else "CSV"
        raise InputError(f"is not a readable {kind} file: {error}", file=path) from error


def _parquet_table(path: Path) -> dict[str, NDArray[np.float64]]:
    with pq.ParquetFile(path) as file:
        schema = file.schema_arrow
        if FORMAT_COLUMN in schema.names and file.metadata.num_rows:
            rows = next(file.iter_batches(1, columns=[FORMAT_COLUMN]))
            _check_format(rows[0][0].as_py(), path)
        _refuse(_missing(schema.names), path)
        wanted = [field for field in schema if field.name in POSE_COLUMNS + TWIST_COLUMNS]
        faults = [
            f"column {field.name}: is of type {field.type}; a number is needed"
            for field in wanted
            if not (pa.types.is_floating(field.type) or pa.types.is_integer(field.type))
        ]
        if file.metadata.num_rows > LARGEST_ROWS:
            faults.append(f"has {file.metadata.num_rows} rows; allowed are {LARGEST_ROWS} at most")
        _refuse(faults, path)
        table = file.read(columns=[field.name for field in wanted])
    return {
        # A null becomes NaN here and is refused as such, with its row.
        name: table[name].to_numpy(zero_copy_only=False).astype(float)
        for name in table.column_names
    }


def _csv_table(path: Path) -> dict[str, NDArray[np.float64]]:
    faults: list[str] = []
    columns: dict[str, array[float]] = {}
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            lines = csv.reader(file)
            header = [name.strip() for name in next(lines, [])]
            # An empty line, as some programs leave at the end, is no row.
            rows = (line for line in lines if line)
            if FORMAT_COLUMN in header and (first := next(rows, None)) is not None:
                _check_format(dict(zip(header, first, strict=False)).get(FORMAT_COLUMN), path)
                rows = chain([first], rows)
            _refuse(_missing(header), path)
            columns = {name: array("d") for name in header if name in POSE_COLUMNS + TWIST_COLUMNS}
            for number, row in enumerate(rows, start=1):
                if len(row) != len(header):
                    faults.append(
                        f"row {number}: has {len(row)} entries, the header has {len(header)}"
                    )
                    continue
                for name, text in zip(header, row, strict=True):
                    if name in columns:
                        columns[name].append(_number(text, f"row {number}, column {name}", faults))
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"is not a readable CSV file: {error}", file=path) from error
    _refuse(faults, path)
    return {name: np.array(values) for name, values in columns.items()}


def _number(text: str, where: str, faults: list[str]) -> float:
    """The number that a text stands for; 0 with a fault noted where it stands for none."""
    try:
        if "_" in text:  # Python reads 1_0 as ten; no other program writes it
            raise ValueError
        return float(text)
    except ValueError:
        shown = text if len(text) <= 40 else text[:37] + "..."
        faults.append(f"{where} = {shown!r}: is not a number")
        return 0.0
