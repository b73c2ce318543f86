"""Two runs side by side: whether they agree, where they part first, and in which quantity.

In come excerpts of two runs, the ticks at which both are known; out comes a verdict with a line for
every quantity that differs, the first to move on top. Two values agree where
|a - b| <= atol + rtol |b| with the tolerances of `workcell.signals`. Some quantities have rules
of their own, since rounding alone may decide them:

    times to collision   are compared as their reciprocals, null being 0: what stands still has none
    indices of pairs     agree if both pairs are equally far and close equally fast
    what belongs to the smallest time to collision is passed over where nothing closes to speak of
    rotations            agree up to the sign of the quaternion, which means nothing
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from workcell.errors import InputError, TraceError
from workcell.scenario import Scenario
from workcell.signals import STAGES, Column, Layout, columns
from workcell.trace.table import Trace

RESTING_PER_S = 1e-4
"""Reciprocal times to collision below it are those of arms that stand: at 10 cm it is a closing
speed of ten micrometres a second, the tolerance of the rates themselves."""

NOT_MOTION = ("name", "description", "expect", "vary")
"""Entries of a scenario that leave the motion as it is; two runs that differ in them can be compared."""
LENGTH = "simulation.duration_s"
"""A run of another length is compared as far as both go."""

TTC_SIGNALS = ("ttc_s", "ttc_command_s")
PAIR_INDICES = ("closest_pair", "ttc_pair", "ttc_command_pair", "limiting_pair")
OF_SMALLEST_TTC = ("ttc_pair", "ttc_command_pair", "closing_cause", "witness_i_m", "witness_j_m")
PLANT_REASON = "servo_lag"
"""A reason the plant gives, not the controller; open loop, where there is no plant, passes it over."""

Kind = Literal["same", "differs", "not comparable"]


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
class Comparison:
    """The verdict on a run against a reference."""

    kind: Kind
    """Same, differs, or not comparable."""
    run: str
    """Where the run comes from."""
    reference: str
    """Where the reference comes from."""
    obstacles: tuple[str, ...]
    """Why the two cannot be compared; empty if they can."""
    differences: tuple[Difference, ...]
    """By first tick, and at equal ticks in the order of the control tick: the first is where to look."""
    ticks: tuple[int, int]
    """Lengths of run and reference."""
    compared: int
    """Ticks at which both are known."""
    notes: tuple[str, ...]
    """What differs without being a difference: versions, platform, settings that were let pass."""

    @property
    def first(self) -> Difference | None:
        """The quantity that moved first."""
        return self.differences[0] if self.differences else None

    def headline(self) -> str:
        """The verdict in one sentence."""
        if self.kind == "not comparable":
            return f"not comparable: {'; '.join(self.obstacles)}"
        length = (
            ""
            if self.ticks[0] == self.ticks[1]
            else f", {self.ticks[0]} ticks instead of {self.ticks[1]}"
        )
        if self.kind == "same":
            return f"same over {self.compared} compared ticks{length}"
        if self.first is None:
            return f"differs{length}"
        at = self.first
        return (
            f"differs from tick {at.first_tick} ({at.first_time_s:.3f} s) on, "
            f"first in {at.column} (stage {at.stage}){length}"
        )


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


def compare(
    run: Excerpt,
    reference: Excerpt,
    *,
    slack_ticks: int = 0,
    widen: float = 1.0,
    other_settings: bool = False,
    without_plant: bool = False,
) -> Comparison:
    """Compare a run with a reference.

    Args:
        run: The run; all its ticks should be known.
        reference: What it is held against, at whatever ticks it is known.
        slack_ticks: A value may be what the run has up to so many ticks earlier or later.
        widen: Factor on all tolerances.
        other_settings: Compare although settings differ, as long as arms, joints and pairs agree.
        without_plant: One side had no plant: what only a plant can report is passed over.
    """
    obstacles, notes = _identities(run.identity, reference.identity, other_settings)
    base = Comparison(
        "not comparable", run.source, reference.source, tuple(obstacles), (),
        (run.length, reference.length), 0, tuple(notes),
    )  # fmt: skip
    if obstacles:
        return base
    common = np.isin(reference.ticks, run.ticks)
    if not common.any():
        return replace(base, obstacles=("no tick is known of both",))
    rows = np.searchsorted(run.ticks, reference.ticks[common])
    ordered = {c.name: c for c in columns(reference.identity.layout)}
    period_s = float(reference.identity.settings.get("simulation", {}).get("period_s", np.nan))
    differences = []
    for name, wanted, values in _quantities(run, reference, ordered):
        column = ordered[name.partition("|")[0]]
        judge = _judge(column, values, wanted[common], rows, widen, slack_ticks, without_plant)
        if column.signal.name in PAIR_INDICES:
            judge = judge.excused(reference.tied[column.name][common])
        if column.signal.name in OF_SMALLEST_TTC:
            judge = judge.without(_resting(run, reference, common, rows))
        found = judge.difference(name, column, reference.ticks[common], period_s)
        if found:
            differences.append(found)
    places = {name: k for k, name in enumerate(ordered)}
    differences.sort(
        key=lambda d: (d.first_tick, STAGES.index(d.stage), places[d.column.partition("|")[0]])
    )
    missing = sorted(
        set(ordered) - {n.partition("|")[0] for n in reference.values} - {"tick", "time_s"}
    )
    if missing:
        notes.append(f"not in the reference: {', '.join(missing)}")
    same = not differences and run.length == reference.length
    return replace(
        base,
        kind="same" if same else "differs",
        differences=tuple(differences),
        compared=int(common.sum()),
        notes=tuple(notes),
    )


# -------------------------------------------------------------------- may they be compared


def _identities(
    run: Identity, reference: Identity, other_settings: bool
) -> tuple[list[str], list[str]]:
    """Why two runs cannot be compared, and what is worth a note."""
    obstacles, notes = [], []
    if run.schema_version != reference.schema_version:
        obstacles.append(
            f"schema version {run.schema_version} of the run, {reference.schema_version} of the reference"
        )
    for what in ("arms", "joints", "pairs"):
        mine, theirs = getattr(run.layout, what), getattr(reference.layout, what)
        if mine != theirs:
            obstacles.append(f"other {what}: {_set_difference(mine, theirs)}")
    changed = settings_changes(run.settings, reference.settings)
    if changed and other_settings:
        notes.append(f"settings differ: {', '.join(changed)}")
    elif changed:
        names = (run.settings.get("name"), reference.settings.get("name"))
        obstacles.append(
            f"other scenario ({names[0]} against {names[1]}): {', '.join(changed[:6])}"
            + (f" and {len(changed) - 6} more" if len(changed) > 6 else "")
        )
    for name in sorted(set(run.versions) | set(reference.versions)):
        mine, theirs = run.versions.get(name, "none"), reference.versions.get(name, "none")
        if mine != theirs:
            notes.append(f"{name} {mine}, reference {theirs}")
    if run.platform != reference.platform:
        notes.append(f"on {run.platform}, reference on {reference.platform}")
    return obstacles, notes


def settings_changes(run: Mapping[str, Any], reference: Mapping[str, Any]) -> list[str]:
    """The settings of two resolved scenarios that differ and matter to the motion, `key run | reference`.

    Keys that one of them does not know yet count with their defaults.
    """
    mine, theirs = _flat(_resolved(run)), _flat(_resolved(reference))
    return [
        f"{key} {mine.get(key, 'none')} | {theirs.get(key, 'none')}"
        for key in sorted(set(mine) | set(theirs))
        if mine.get(key) != theirs.get(key)
        and key.partition(".")[0] not in NOT_MOTION
        and key != LENGTH
    ]


def _resolved(settings: Mapping[str, Any]) -> Mapping[str, Any]:
    """The settings with every default of today's schema; what it cannot read is compared as it stands."""
    if not settings:
        return settings
    try:
        return Scenario.model_validate(dict(settings)).model_dump(mode="json")
    except (ValueError, InputError):
        return settings


def _flat(node: Any, prefix: str = "") -> dict[str, Any]:
    """Dotted keys; entries of lists by their name, or their place."""
    if isinstance(node, Mapping):
        items = list(node.items())
    elif isinstance(node, (list, tuple)) and any(isinstance(x, Mapping) for x in node):
        items = [(x.get("name", k) if isinstance(x, Mapping) else k, x) for k, x in enumerate(node)]
    else:
        return {prefix: list(node) if isinstance(node, tuple) else node}
    flat: dict[str, Any] = {}
    for key, value in items:
        flat |= _flat(value, f"{prefix}.{key}" if prefix else str(key))
    return {key: value for key, value in flat.items() if value is not None}


def _set_difference(mine: tuple[Any, ...], theirs: tuple[Any, ...]) -> str:
    """What one has that the other lacks."""

    def text(items: list[Any]) -> str:
        names = [" and ".join(x) if isinstance(x, tuple) else str(x) for x in items]
        return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")

    only = [x for x in mine if x not in theirs], [x for x in theirs if x not in mine]
    if not any(only):
        return "in another order"
    return "; ".join(
        f"only the {who} has {text(items)}"
        for who, items in zip(("run", "reference"), only, strict=True)
        if items
    )


# -------------------------------------------------------------------- one quantity


def _quantities(
    run: Excerpt, reference: Excerpt, ordered: Mapping[str, Column]
) -> Iterator[tuple[str, NDArray[Any], NDArray[Any]]]:
    """Every quantity of the reference: name, its values there, and the run's at all its ticks.

    `<column>|sum` and `<column>|moment` stand for a vector over pairs, see `condensed`.
    """
    for name, wanted in reference.values.items():
        column, _, condensation = name.partition("|")
        if column not in ordered:
            raise TraceError(f"{reference.source}: column {name} is none of this version's signals")
        if column not in run.values:
            raise TraceError(f"{run.source}: is from before column {column!r} was logged")
        values = run.values[column]
        yield name, wanted, condensed(values)[condensation] if condensation else values


def condensed(values: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Two numbers a tick for a vector over pairs: its sum, and its moment over the places in the list.

    A change in any one pair, or a pair that is dropped, moves both; a swap of two moves the moment.
    """
    places = np.arange(1, values.shape[1] + 1) / max(1, values.shape[1])
    return {"sum": values.sum(axis=1), "moment": values @ places}


@dataclass(frozen=True)
class _Judge:
    """Run and reference in one quantity, row by row."""

    excess: NDArray[np.float64]
    """(R,) or (R, n): how far the run is from the reference, infinite where only one is null."""
    differs: NDArray[np.bool_]
    """Same shape: whether that is more than allowed."""
    run: NDArray[Any]
    """What the run has."""
    reference: NDArray[Any]
    """What the reference has."""

    def without(self, rows: NDArray[np.bool_]) -> _Judge:
        """The same, with some rows passed over."""
        apart = rows if self.differs.ndim == 1 else rows[:, None]
        return replace(self, differs=self.differs & ~apart)

    def excused(self, tied: NDArray[np.bool_]) -> _Judge:
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


def _judge(
    column: Column,
    run: NDArray[Any],
    reference: NDArray[Any],
    rows: NDArray[np.intp],
    widen: float,
    slack_ticks: int,
    without_plant: bool,
) -> _Judge:
    """Hold a run's values against a reference's; with slack, against the nearest within so many ticks."""
    signal = column.signal
    if without_plant and signal.name == "reason":
        run, reference = (np.where(x == PLANT_REASON, "", x) for x in (run, reference))
    window = [
        np.clip(rows + shift, 0, len(run) - 1) for shift in range(-slack_ticks, slack_ticks + 1)
    ]
    if signal.dtype != "float64":
        differs = np.all([run[shifted] != reference for shifted in window], axis=0)
        return _Judge(differs.astype(float), differs, run[rows], reference)
    a, b = run, reference
    if signal.name in TTC_SIGNALS:
        a, b = _reciprocal(run), _reciprocal(reference)
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
    return _Judge(excess, excess > allowed, run[rows], reference)


def _reciprocal(ttc_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """1/s, 0 where there is no collision ahead; a time of 0 counts as the shortest a float holds."""
    return np.where(np.isnan(ttc_s), 0.0, 1.0 / np.maximum(ttc_s, np.finfo(float).tiny * 4))


def _resting(
    run: Excerpt, reference: Excerpt, common: NDArray[np.bool_], rows: NDArray[np.intp]
) -> NDArray[np.bool_]:
    """(R,) where nothing closes to speak of, in either."""
    return (_reciprocal(run.values["ttc_s"])[rows] < RESTING_PER_S) & (
        _reciprocal(reference.values["ttc_s"])[common] < RESTING_PER_S
    )


def _shown(value: Any) -> str:
    if isinstance(value, (float, np.floating)):
        return "null" if np.isnan(value) else f"{value:.9g}"
    if isinstance(value, (int, np.integer)):
        return "null" if value < 0 else str(value)
    return repr(str(value))
