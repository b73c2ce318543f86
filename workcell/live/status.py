"""What a person is told while driving: numbers, colours and plain words, from the record of a tick."""

from __future__ import annotations

import math
from dataclasses import dataclass

from workcell.control.controller import Controller
from workcell.control.record import ArmRecord, TickRecord
from workcell.motion.setpoint import VALID, WAITING
from workcell.scene.cell import Cell

RED_SHARE, AMBER_SHARE = 1.1, 2.0
"""Below these multiples of t_min the time to collision is red or amber. A support arm that slows down holds t_min
itself, so red means that it is being held, and amber that it soon will be."""
GREEN, AMBER, RED = "green", "amber", "red"
TTC_SHOWN_S = 99.9
"""Largest time that is shown as a number."""
STANDING_SCALE = 0.02
"""Speed scale below which an arm is said to wait."""

_JOBS = {
    "start": "is about to begin",
    "move": "moves along its path",
    "meet": "goes to meet its partner",
    "retreat": "draws back",
    "present": "presents what it brings",
    "fetch": "fetches an instrument",
    "put": "puts an instrument down",
    "exchange": "hands over",
    "dwell": "has arrived and stays",
    "wait": "waits, as its job says",
    "done": "has done its jobs",
}
_ATTEMPTS = {
    "detour": "leaves its path to get past",
    "self_motion": "folds its elbow to get past",
    "free_rotation": "turns its tool to get past",
    "elbow_left": "swings its elbow to the left to get past",
    "elbow_right": "swings its elbow to the right to get past",
    "back_off": "backs off to get past",
    "re_enter": "tries another side",
}
_INPUTS = {
    VALID: "follows you",
    WAITING: "waits for your first move",
    "stale": "stands: the input has stopped",
    "late": "stands: the input comes too late",
    "jump": "stands: the input leapt",
    "frozen": "stands: the input is frozen",
    "catching_up": "catches up with you",
}


@dataclass(frozen=True)
class ArmStatus:
    """One arm in words."""

    name: str
    live: bool
    """Whether a person drives it."""
    words: str
    colour: str


@dataclass(frozen=True)
class Status:
    """One moment of a session."""

    time_s: float
    ttc_s: float | None
    """Smallest time to collision; None where nothing closes."""
    artc_per_s: float
    """Largest average reciprocal time to collision of the arms that are driven."""
    t_min_s: float
    colour: str
    """Of the gauge and of the line between the closest pair."""
    pair: str
    """The pair that collides first, else the nearest, in words."""
    distance_m: float | None
    """Of that pair."""
    criterion: str
    entry: str
    """The approach side asked for; empty as the jobs say."""
    halt: str
    """Why the final check has stopped the support arms; empty if it has not."""
    arms: tuple[ArmStatus, ...]


def status(
    cell: Cell, controller: Controller, *, out_of_reach: frozenset[str], halt: str
) -> Status:
    """The present moment.

    Args:
        cell: What is simulated.
        controller: After a tick.
        out_of_reach: Live arms whose tools have stopped short of their targets.
        halt: Why the final check has stopped the support arms; empty if it has not.
    """
    record, settings = controller.record, controller.settings
    shown = record.ttc_pair if record.ttc_pair is not None else record.closest_pair
    live = {name for name, row in record.arms.items() if row.operator_state}
    return Status(
        time_s=record.time_s,
        ttc_s=record.ttc_s,
        artc_per_s=max((record.arms[name].artc_per_s for name in live), default=0.0),
        t_min_s=settings.t_min_s,
        colour=RED if halt else ttc_colour(record.ttc_s, settings.t_min_s),
        pair="" if shown is None else pair_words(cell, shown),
        distance_m=None if shown is None else float(record.pair_distance_m[shown]),
        criterion=settings.criterion,
        entry=settings.entry,
        halt=halt,
        arms=tuple(
            ArmStatus(
                name,
                name in live,
                arm_words(cell, record, name, out_of_reach=name in out_of_reach, halt=halt),
                _arm_colour(row, name in out_of_reach, halt),
            )
            for name, row in record.arms.items()
        ),
    )


def ttc_colour(ttc_s: float | None, t_min_s: float) -> str:
    """Green, amber or red; green where nothing closes."""
    if ttc_s is None or ttc_s > AMBER_SHARE * t_min_s:
        return GREEN
    return RED if ttc_s <= RED_SHARE * t_min_s else AMBER


def ttc_words(ttc_s: float | None) -> str:
    """The time to collision as a number a person can read; where nothing closes, a dash."""
    if ttc_s is None or not math.isfinite(ttc_s):
        return "–"
    return f"{ttc_s:.2f} s" if ttc_s <= TTC_SHOWN_S else f"over {TTC_SHOWN_S:.0f} s"


def pair_words(cell: Cell, pair: int) -> str:
    """Both sides of a watched pair."""
    return " – ".join(side_words(cell, pair, side) for side in (0, 1))


def side_words(cell: Cell, pair: int, side: int) -> str:
    """One side of a watched pair: `link3 of the surgeon`, or the name of what stands."""
    name, owner = cell.pairs.names[pair][side], cell.pairs.owners[pair][side]
    part = name.rsplit("/", 1)[-1].removesuffix("_capsule").replace("_", " ")
    arms = {arm.name for arm in cell.arms}
    return f"{part} of the {owner}" if owner in arms else f"the {part}"


def other_words(cell: Cell, pair: int | None, arm: str) -> str:
    """What an arm has to do with in a pair: the other side of it."""
    if pair is None:
        return "something"
    owners = cell.pairs.owners[pair]
    return side_words(cell, pair, 1 if owners[0] == arm else 0)


def arm_words(
    cell: Cell, record: TickRecord, arm: str, *, out_of_reach: bool = False, halt: str = ""
) -> str:
    """What an arm does, and why, in one line."""
    row = record.arms[arm]
    if row.operator_state:
        if out_of_reach or row.out_of_reach_m is not None:
            short_m = row.tool_error_m if row.out_of_reach_m is None else row.out_of_reach_m
            return f"cannot reach farther: {100 * short_m:.0f} cm short"
        return _INPUTS.get(row.operator_state, f"stands: the input is {_plain(row.operator_state)}")
    if halt:
        return "is stopped by the final check"
    other = other_words(cell, row.limiting_pair, arm)
    if row.mode == "yield":
        return f"gives way: {other} comes"
    if row.attempt:
        return _ATTEMPTS.get(row.attempt, f"tries to get past: {_plain(row.attempt)}")
    if row.limiting_pair is not None and row.job not in ("wait", "done", "dwell"):
        if abs(row.scale) < STANDING_SCALE:
            return f"waits: {other} {_verb(cell, row.limiting_pair, arm)}"
        if row.scale < 1.0 and row.mode == "scale":
            return f"slows down to {100 * row.scale:.0f} %: {other} {_verb(cell, row.limiting_pair, arm)}"
    if row.mode == "hold" and row.job not in ("wait", "done"):
        return "waits: it found no way past"
    return _JOBS.get(row.job, _plain(row.job))


def _verb(cell: Cell, pair: int, arm: str) -> str:
    """What the other side of a pair does to an arm: another arm comes, what stands is near."""
    owners = cell.pairs.owners[pair]
    other = owners[1] if owners[0] == arm else owners[0]
    return "comes" if other in {a.name for a in cell.arms} - {arm} else "is near"


def _arm_colour(row: ArmRecord, out_of_reach: bool, halt: str) -> str:
    if row.operator_state:
        beyond = out_of_reach or row.out_of_reach_m is not None
        return RED if beyond else GREEN if row.operator_state == VALID else AMBER
    if halt:
        return RED
    if row.mode in ("yield", "halt") or abs(row.scale) < STANDING_SCALE:
        return RED if row.limiting_pair is not None else GREEN
    return AMBER if row.mode in ("scale", "hold") or row.attempt else GREEN


def _plain(name: str) -> str:
    return name.replace("_", " ")
