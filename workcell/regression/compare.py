"""Two runs side by side: whether they agree, where they part first, and in which quantity.

In come excerpts of two runs; out comes a verdict with a line for every quantity that differs, the
first to move on top. Rounding alone may decide some quantities, which have rules of their own:

    times to collision   are compared as their reciprocals, null being 0: what stands still has none
    indices of pairs     agree if both pairs are equally far and close equally fast
    what belongs to the smallest time to collision is passed over where no pair closes noticeably
    rotations            agree up to the sign of the quaternion, which means nothing
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from workcell.errors import TraceError
from workcell.regression.agreement import Difference, hold_against, reciprocal
from workcell.regression.excerpt import PAIR_INDICES, Excerpt, Identity, condensed
from workcell.regression.settings import settings_changes
from workcell.signals import STAGES, Column, columns

RESTING_PER_S = 1e-4
"""Reciprocal times to collision below it are those of arms that stand: at 10 cm it is a closing
speed of ten micrometres a second, the tolerance of the rates themselves."""

OF_SMALLEST_TTC = ("ttc_pair", "ttc_command_pair", "closing_cause", "witness_i_m", "witness_j_m")
"""Signals that belong to the smallest time to collision."""

Kind = Literal["same", "differs", "not comparable"]


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
        if without_plant and column.signal.stage == "plant":
            continue
        agreement = hold_against(
            column, values, wanted[common], rows, widen, slack_ticks, without_plant
        )
        if column.signal.name in PAIR_INDICES:
            agreement = agreement.excused(reference.tied[column.name][common])
        if column.signal.name in OF_SMALLEST_TTC:
            agreement = agreement.without(_resting(run, reference, common, rows))
        found = agreement.difference(name, column, reference.ticks[common], period_s)
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


def _resting(
    run: Excerpt, reference: Excerpt, common: NDArray[np.bool_], rows: NDArray[np.intp]
) -> NDArray[np.bool_]:
    """(R,) where nothing closes to speak of, in either."""
    return (reciprocal(run.values["ttc_s"])[rows] < RESTING_PER_S) & (
        reciprocal(reference.values["ttc_s"])[common] < RESTING_PER_S
    )
