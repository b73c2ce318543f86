"""Is a scenario fit to run? All that a run would refuse is found here, before a folder is made.

`workcell check` and every run ask the same functions, so that what `check` passes is never refused later.
What a run finds out only as it happens (a hand that goes where nobody could know) is its result, not a refusal.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import mujoco

from workcell.control import feasible, meeting_reach
from workcell.control.arm_criterion import ArmCriterion
from workcell.control.steering import Strategies
from workcell.errors import InputError, refused
from workcell.guard.check_setup import refusal, try_checker
from workcell.guard.checker import Checker
from workcell.guard.shared_memory import CLOSED, NOBODY, Request
from workcell.scenario import Scenario
from workcell.scene import cell as scene
from workcell.scene.cell import Cell
from workcell.scene.compose import SCENE_FILE
from workcell.trace import expectations

STOPPED_BY_CHECK = "stopped_by_check"
"""Metric: the state in which the final check stopped the arms."""
MOST_PAIRS = 5000
"""Watched pairs of a cell; each is three numbers of every row of the trace, and time of every tick."""


@dataclass(frozen=True)
class Admission:
    """A scenario that can be run."""

    cell: Cell
    checker: Checker | None
    """The final check as it will be, without its process; None where it is switched off."""


def admit(scenario: Scenario, folder: Path) -> Admission:
    """Build the cell in a folder and judge all of it.

    Args:
        scenario: What is to be run.
        folder: Where the scene is written; made if missing.

    Raises:
        InputError: it cannot be run; every fault that could be found, each with its key.
    """
    faults = expectations.faults(scenario)
    if faults:
        raise InputError(faults, file=scenario.file)
    with refused("the scene cannot be built", OSError, mujoco.FatalError, file=scenario.file):
        cell = scene.build(scenario, folder)
    _enough(cell)
    scene.check_start(cell)
    _all_of(
        scenario,
        [
            lambda: feasible.check(cell),
            lambda: meeting_reach.check(cell),
            lambda: _plugins_can_be_made(cell),
        ],
    )
    checker = None
    if scenario.check.enabled:
        checker = try_checker(cell, folder / SCENE_FILE)
        # A scenario that is there to be stopped says so.
        if STOPPED_BY_CHECK not in scenario.expect:
            _first_look(cell, checker)
    return Admission(cell, checker)


def _all_of(scenario: Scenario, checks: Iterable[Callable[[], None]]) -> None:
    """Ask all of several checks, and refuse with what all of them found."""
    faults: list[str] = []
    for check in checks:
        try:
            check()
        except InputError as error:
            faults += error.faults
    if faults:
        raise InputError(faults, file=scenario.file)


def _plugins_can_be_made(cell: Cell) -> None:
    Strategies(cell)
    for arm in cell.arms:
        ArmCriterion(cell.scenario, arm.name)


def _enough(cell: Cell) -> None:
    """Refuse a cell whose rows nobody could write or read."""
    if len(cell.pairs) > MOST_PAIRS:
        raise InputError(
            f"arm, obstacle, instrument: their capsules make {len(cell.pairs):,} watched pairs; allowed is "
            f"{MOST_PAIRS:,}: leave out what is far away, or give the arms fewer capsules",
            file=cell.scenario.file,
        )


def _first_look(cell: Cell, checker: Checker) -> None:
    """The verdict of the final check on the start, which a run would get at its first tick."""
    data = mujoco.MjData(cell.model)
    cell.place_home(data)
    names = [arm.name for arm in cell.arms]
    answer = checker.answer(
        Request(
            sequence=1,
            tick=0,
            opened_ticks=(CLOSED,) * len(checker.settings.exemptions),
            qpos=data.qpos.copy(),
            holders=tuple(
                NOBODY if item.held_by is None else names.index(item.held_by)
                for item in cell.instruments
            ),
        )
    )
    if answer.halt:
        pieces = [checker.geometry.pieces[k] for k in answer.pair if k >= 0]
        near = " and ".join(piece.name for piece in pieces) or "two pieces"
        advice = ""
        if len(pieces) == 2 and pieces[0].owner == pieces[1].owner:
            one, other = (piece.body_name.partition("/")[2] for piece in pieces)
            advice = (
                "; if they touch by construction, say so in the arm file: "
                f'<contact><exclude body1="{one}" body2="{other}"/></contact>, or in the scenario: [[ignore]]'
            )
        raise refusal(
            cell,
            [
                f"stops the arms at their start: {near} are {answer.distance_m:.4f} m apart; "
                f"allowed is more than d_min_m = {checker.settings.d_min_m:g}{advice}"
            ],
        )
