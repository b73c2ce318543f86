"""A run as small text that can be read in a diff: what a reference is stored as.

In comes a trace, out come two kinds of CSV file, one line a tick, every number rounded to a twentieth
of its tolerance:

    rows     what the controller put out, at selected ticks: the first few, one every half second,
             and two wherever a mode or a job changes, so that a change shows where it begins.
             A vector over pairs enters as two numbers (`workcell.regression.compare.condensed`)
    states   what the controller was fed, as knots a tenth of a second apart; between them the
             states of every tick follow by cubic interpolation, the same on every machine
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workcell.errors import TraceError
from workcell.regression.agreement import TTC_SIGNALS
from workcell.regression.excerpt import (
    PAIR_INDICES,
    Excerpt,
    Identity,
    condensed,
    ties,
)
from workcell.signals import Column, columns
from workcell.trace.readings import period_s
from workcell.trace.table import Trace

ROW_S = 0.5
"""Distance of rows; chosen so that a run of twenty seconds stays near 100 kB."""
KNOT_S = 0.1
"""Distance of knots; chosen well below the quarter second in which a factor may rise, so that what is
fed still looks like a run."""
FIRST_TICKS = 8
"""Ticks known from the start without a gap: most changes of a controller show here, before its memory
has carried them into every other quantity."""
KNOT_ATOL = {"qpos": 1e-7, "qvel": 1e-6, "check_distance_m": 1e-6}
"""What knots are rounded to. Reference outputs are those for the rounded states: nothing is lost."""
TUNED = ("t_min_s", "criterion", "entry")
"""Signals that are parameters of the controller, which a person may change during a run."""
EVENTS = ("mode", "job", "ik_status", "check_state")
"""Signals whose changes are worth a row."""


@dataclass(frozen=True)
class Targets:
    """Where one arm's tool was meant to be, tick by tick."""

    position_m: NDArray[np.float64]
    """(T, 3) in the world."""
    wxyz: NDArray[np.float64]
    """(T, 4) orientation in the world."""
    velocity_m_s: NDArray[np.float64]
    """(T, 3) its velocity."""
    turn_rad_s: NDArray[np.float64]
    """(T, 3) its angular velocity."""
    job: NDArray[np.object_]
    """(T,) what its operator was doing."""
    state: NDArray[np.object_]
    """(T,) whether the operator's input was sound."""


@dataclass(frozen=True)
class States:
    """What a controller was fed, tick by tick."""

    qpos: NDArray[np.float64]
    """(T, nq) positions it saw."""
    qvel: NDArray[np.float64]
    """(T, nv) velocities it saw."""
    check_state: NDArray[np.object_]
    """(T,) what the final check said."""
    check_distance_m: NDArray[np.float64]
    """(T,) its distance; NaN where it had none."""
    tuning: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    """(T,) of each parameter that may change during a run; empty where none did."""
    targets: Mapping[str, Targets] = field(default_factory=dict)
    """What each arm was after, for those whose operator cannot be asked again."""

    def __len__(self) -> int:
        return len(self.qpos)


def states(trace: Trace) -> States:
    """What the controller of a run was fed at every tick."""
    known = trace.column_names
    return States(
        trace["qpos"],
        trace["qvel"],
        trace["check_state"],
        trace["check_distance_m"],
        {name: trace[name] for name in TUNED if name in known},
        {
            arm: Targets(
                trace[f"{arm}.target_position_m"],
                trace[f"{arm}.target_wxyz"],
                trace[f"{arm}.target_velocity_m_s"],
                trace[f"{arm}.target_turn_rad_s"],
                trace[f"{arm}.job"],
                trace[f"{arm}.operator_state"],
            )
            for arm in trace.layout.arms
            if {f"{arm}.operator_state", f"{arm}.target_turn_rad_s"} <= set(known)
        },
    )


def write_states(path: Path, trace: Trace) -> None:
    """Write knots of the states of a run."""
    fed = states(trace)
    every = max(1, round(KNOT_S / period_s(trace)))
    changes = np.flatnonzero(fed.check_state[1:] != fed.check_state[:-1])
    ticks = {*range(0, len(fed), every), len(fed) - 1, *changes, *(changes + 1)}
    names = ["tick", *_names("qpos", trace.layout.nq), *_names("qvel", trace.layout.nv)]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*names, "check_state", "check_distance_m"])
        for tick in sorted(int(t) for t in ticks):
            writer.writerow(
                [
                    tick,
                    *(_rounded(x, KNOT_ATOL["qpos"]) for x in fed.qpos[tick]),
                    *(_rounded(x, KNOT_ATOL["qvel"]) for x in fed.qvel[tick]),
                    fed.check_state[tick],
                    _rounded(fed.check_distance_m[tick], KNOT_ATOL["check_distance_m"]),
                ]
            )


def read_states(path: Path, period_s: float) -> States:
    """The states of every tick of `period_s`, from their knots.

    Between knots positions are the cubic with the knots' positions and velocities, velocities its
    derivative, and the final check says what it said at the knot before. Instruments, whose free
    joints come after those of all arms, go straight from knot to knot.
    """
    content = _read(path)
    knots = np.array([int(x) for x in content["tick"]])
    q, v = _numbers(content, "qpos"), _numbers(content, "qvel")
    ticks = np.arange(knots[-1] + 1)
    left = np.clip(np.searchsorted(knots, ticks, side="right") - 1, 0, max(0, len(knots) - 2))
    right = np.minimum(left + 1, len(knots) - 1)
    span = np.maximum(1, knots[right] - knots[left])
    u = ((ticks - knots[left]) / span)[:, None]
    # Velocities of the knots are per second, the cubic's parameter runs from knot to knot.
    step_s = (span * period_s)[:, None]
    a, b, da, db = q[left], q[right], v[left] * step_s, v[right] * step_s
    free = q.shape[1] - v.shape[1]  # a free joint has seven positions and six velocities
    hinges = v.shape[1] - 6 * free
    qa, qb = a[:, :hinges], b[:, :hinges]
    da, db = da[:, :hinges], db[:, :hinges]
    qpos = (
        (1 + 2 * u) * (1 - u) ** 2 * qa
        + u * (1 - u) ** 2 * da
        + u**2 * (3 - 2 * u) * qb
        + u**2 * (u - 1) * db
    )
    slope = (
        6 * u * (u - 1) * (qa - qb) + (1 - u) * (1 - 3 * u) * da + u * (3 * u - 2) * db
    ) / step_s
    blend = np.clip(u, 0.0, 1.0)
    loose = (1 - blend) * a[:, hinges:] + blend * b[:, hinges:]
    for k in range(free):
        turn = slice(7 * k + 3, 7 * k + 7)
        loose[:, turn] /= np.linalg.norm(loose[:, turn], axis=1, keepdims=True)
    before = np.searchsorted(knots, ticks, side="right") - 1
    return States(
        np.hstack([qpos, loose]),
        np.hstack([slope, (1 - blend) * v[left, hinges:] + blend * v[right, hinges:]]),
        np.array(content["check_state"], dtype=object)[before],
        _floats(content["check_distance_m"])[before],
    )


def reference_ticks(trace: Trace) -> NDArray[np.int64]:
    """The ticks at which a reference remembers a run."""
    length = len(trace)
    every = max(1, round(ROW_S / period_s(trace)))
    ticks = {*range(min(FIRST_TICKS, length)), *range(0, length, every), length - 1}
    for column in columns(trace.layout):
        if column.signal.name in EVENTS:
            values = trace[column.name]
            changed = np.flatnonzero(values[1:] != values[:-1]) + 1
            ticks |= {*changed.tolist(), *(changed + 1).tolist()}
    return np.array(sorted(tick for tick in ticks if tick < length), dtype=np.int64)


def write_rows(path: Path, trace: Trace, *, skip: Sequence[str] = ()) -> None:
    """Write what a controller put out, at `reference_ticks`, without the signals in `skip`."""
    ticks = reference_ticks(trace)
    header, texts = ["tick"], [[str(t) for t in ticks]]
    for column in columns(trace.layout):
        if column.signal.name in ("tick", "time_s", *skip):
            continue
        values = trace[column.name]
        if column.signal.name in PAIR_INDICES:
            tied = ties(trace, values[ticks], ticks)
            header.append(column.name)
            texts.append(["|".join(str(k) for k in np.flatnonzero(row)) for row in tied])
        elif column.signal.shape == "pairs":
            for name, part in condensed(values).items():
                header.append(f"{column.name}|{name}")
                texts.append([_text(column, x) for x in part[ticks]])
        elif column.width is None:
            header.append(column.name)
            texts.append([_text(column, x) for x in values[ticks]])
        else:
            header += _names(column.name, column.width)
            texts += [[_text(column, x) for x in part] for part in values[ticks].T]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(zip(*texts, strict=True))


def read_rows(path: Path, identity: Identity, length: int) -> Excerpt:
    """What `write_rows` wrote, ready for a comparison.

    Args:
        path: The file.
        identity: What the run was; kept beside the rows.
        length: Ticks of the whole run.
    """
    content = _read(path)
    known = {c.name: c for c in columns(identity.layout)}
    values: dict[str, NDArray[Any]] = {}
    tied: dict[str, NDArray[np.bool_]] = {}
    for name in dict.fromkeys(key.partition("[")[0] for key in content if key != "tick"):
        column = known.get(name.partition("|")[0])
        if column is None:
            raise TraceError(f"{path}: column {name} is none of this version's signals")
        if column.signal.name in PAIR_INDICES:
            tied[name] = np.zeros((len(content["tick"]), len(identity.layout.pairs)), dtype=bool)
            values[name] = np.full(len(content["tick"]), -1)
            for row, text in enumerate(content[name]):
                for pair in text.split("|") if text else ():
                    tied[name][row, int(pair)] = True
                    values[name][row] = int(pair)
        elif column.width is not None and "|" not in name:
            values[name] = _numbers(content, name)
        elif column.signal.dtype == "float64":
            values[name] = _floats(content[name])
        else:
            values[name] = np.array(content[name], dtype=object)
    ticks = np.array([int(x) for x in content["tick"]], dtype=np.int64)
    return Excerpt(str(path), identity, ticks, length, values, tied)


def _names(name: str, width: int) -> list[str]:
    return [f"{name}[{k}]" for k in range(width)]


def _text(column: Column, value: Any) -> str:
    if column.signal.dtype != "float64":
        return str(value)
    allowed = column.signal.atol + column.signal.rtol * abs(value)
    if column.signal.name in TTC_SIGNALS:
        # The tolerance holds for the reciprocal: |d(1/t)| = |dt| / t².
        allowed = column.signal.atol * value**2 + column.signal.rtol * value
    return _rounded(value, allowed)


def _rounded(value: float, allowed: float) -> str:
    """The shortest decimal within a twentieth of the tolerance; empty for null."""
    if math.isnan(value):
        return ""
    if math.isinf(value) or allowed <= 0.0:
        return repr(float(value))
    decimals = max(0, math.ceil(-math.log10(allowed)) + 1)
    text = f"{value:.{decimals}f}"
    if "." in text:
        text = text.rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def _read(path: Path) -> dict[str, list[str]]:
    """Columns of a CSV file as text."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            header, *lines = csv.reader(file)
    except (OSError, ValueError) as error:
        raise TraceError(f"{path}: is no reference: {error}") from error
    for number, line in enumerate(lines, start=2):
        if len(line) != len(header):
            raise TraceError(f"{path}: line {number} has {len(line)} entries, not {len(header)}")
    if not lines:
        raise TraceError(f"{path}: has no rows")
    return {name: [line[k] for line in lines] for k, name in enumerate(header)}


def _floats(texts: list[str]) -> NDArray[np.float64]:
    return np.array([float(x) if x else np.nan for x in texts])


def _numbers(content: dict[str, list[str]], name: str) -> NDArray[np.float64]:
    """(R, n) a vector from its columns `name[0]`, `name[1]`, ..."""
    parts = []
    while f"{name}[{len(parts)}]" in content:
        parts.append(_floats(content[f"{name}[{len(parts)}]"]))
    return np.column_stack(parts)
