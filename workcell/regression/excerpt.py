"""What two runs are compared by: an identity, and columns at the ticks that are known.

In comes a trace; out comes an `Excerpt`: all ticks of a run, or the selection a reference keeps.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workcell.signals import Layout, columns
from workcell.trace.table import Trace

PAIR_INDICES = ("closest_pair", "ttc_pair", "ttc_command_pair", "limiting_pair", "gate_pair")
"""Signals that are an index of a pair."""


@dataclass(frozen=True)
class Identity:
    """What two runs must share to be compared at all."""

    schema_version: int
    """Version of the list of signals."""
    layout: Layout
    """Arms, joints and pairs."""
    settings: dict[str, Any]
    """The resolved scenario."""
    versions: dict[str, str]
    """Versions of packages; they may differ, and are then noted."""
    platform: str
    """Machine and Python; may differ likewise."""


@dataclass(frozen=True)
class Excerpt:
    """A run at some of its ticks: all of them for a trace, a selection for a reference."""

    source: str
    """Where it comes from, for messages."""
    identity: Identity
    """What the run was."""
    ticks: NDArray[np.int64]
    """(R,) rising ticks that are known."""
    length: int
    """Ticks of the whole run."""
    values: Mapping[str, NDArray[Any]]
    """Column -> (R,) or (R, n); null floats are NaN, null indices -1."""
    tied: Mapping[str, NDArray[np.bool_]]
    """Index column -> (R, P): the pairs that could stand there as well as the one that does."""


def excerpt(trace: Trace, *, skip: tuple[str, ...] = ()) -> Excerpt:
    """The whole of a trace, as a comparison wants it."""
    known = [c for c in columns(trace.layout) if c.name in trace.column_names]
    values = {c.name: trace[c.name] for c in known if c.signal.name not in skip}
    return Excerpt(
        source=str(trace.source),
        identity=identity(trace),
        ticks=trace["tick"],
        length=len(trace),
        values=values,
        tied={c.name: ties(trace, trace[c.name]) for c in known if c.signal.name in PAIR_INDICES},
    )


def identity(trace: Trace) -> Identity:
    """What a trace says of itself."""
    entries = trace.metadata
    return Identity(
        schema_version=int(entries["schema_version"]),
        layout=trace.layout,
        settings=entries.get("settings") or {},
        versions=entries.get("versions") or {},
        platform=str(entries.get("platform", "")),
    )


def ties(
    trace: Trace, index: NDArray[np.integer], ticks: NDArray[np.integer] | None = None
) -> NDArray[np.bool_]:
    """(R, P) the pairs as far apart and closing as fast as the indexed one, itself among them.

    At rising `ticks`, for which `index` is given; None stands for all.

    Two capsules that share an end point have exactly equal distances to a third body that is
    nearest there, and the last bit decides which of the pairs is named.
    """
    tied = np.zeros((len(index), len(trace.layout.pairs)), dtype=bool)
    rows = np.flatnonzero(index >= 0)
    known = rows if ticks is None else ticks[rows]
    tied[rows] = True
    for name in ("pair_distance_m", "pair_rate_m_s"):
        values = trace.part(name, known)
        atol = next(c.signal.atol for c in columns(trace.layout) if c.name == name)
        own = np.take_along_axis(values, index[rows, None].astype(np.intp), axis=1)
        tied[rows] &= np.abs(values - own) <= atol
    return tied


def condensed(values: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Two numbers a tick for a vector over pairs: its sum, and its moment over the places in the list.

    A change in any one pair, or a pair that is dropped, moves both; a swap of two moves the moment.
    """
    places = np.arange(1, values.shape[1] + 1) / max(1, values.shape[1])
    return {"sum": values.sum(axis=1), "moment": values @ places}
