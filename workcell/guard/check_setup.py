"""Scenario -> what the checker is told: limits, who may meet whom in which window, what is held.

The only file of the final check that knows scenarios and compiled cells. Exemptions are named as
the controller names the windows that jobs hold open: `<arm>_<partner>` where two arms meet or hand
an instrument over, `<arm>_<instrument>` where one is fetched.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import mujoco

from workcell.errors import InputError
from workcell.guard.checker import Checker
from workcell.guard.geometry import HOUSING_GROUP
from workcell.guard.settings import DEADLINE_S, CheckSettings, Exemption, Held
from workcell.scenario import Exchange, Fetch, Meet
from workcell.scene.cell import Cell
from workcell.scene.contacts import hand_bodies, window_name
from workcell.scene.hand import tool_body

DEADLINE_TICKS = 5
"""Live, an answer may take at least this many ticks: a machine that needs long ones needs its time for the check, too."""
MEETING_S = 60.0
"""How long two tools may be exempt from the final check if a job forgets to part them; chosen longer than any exchange."""
CLOSING_MARGIN = 1.25
"""A meeting may close this much faster than its path speed: corrections of tool errors come on top, up to a few
percent seen; chosen well above them and well below a second arm's own speed."""


MEETING_NEAR_M = 0.15
"""Farther apart than this a window's pair may close at any speed, as the next job takes the arm elsewhere; chosen five
times the way a PA10 needs to stop from 0.26 m/s."""


def check_settings(cell: Cell) -> CheckSettings:
    """What the checker of a cell is told."""
    scenario = cell.scenario
    start = mujoco.MjData(cell.model)
    cell.place_home(start)
    d_min = scenario.control.d_min_m if scenario.check.d_min_m is None else scenario.check.d_min_m
    deadline = max(DEADLINE_S, DEADLINE_TICKS * cell.period_s)
    return CheckSettings(
        arms=tuple(arm.name for arm in cell.arms),
        d_min_m=d_min,
        period_s=cell.period_s,
        every_ticks=scenario.check.every_ticks,
        deadline_s=deadline,
        max_age_ticks=math.ceil(deadline / cell.period_s) + 1,
        exemptions=_exemptions(cell, d_min),
        instruments=tuple(Held(item.name, item.rests_on) for item in cell.instruments),
        hands=tuple(
            tuple(cell.model.body(body).name for body in sorted(hand_bodies(cell.model, arm)))
            for arm in cell.arms
        ),
        ignored=tuple(
            (*entry.pair, entry.reason) for entry in scenario.ignore if not entry.final_check
        ),
        home=tuple(start.qpos.tolist()),
        release_s=MEETING_S,
    )


def try_checker(cell: Cell, scene_xml: Path) -> Checker:
    """The checker without its process: what a look at a scenario needs.

    Raises:
        InputError: the check could not judge this scene; names the scenario file and every part at fault.
    """
    try:
        checker = Checker(scene_xml, check_settings(cell))
    except InputError as error:
        raise refusal(cell, error.faults) from error
    if checker.geometry.missing:
        raise refusal(cell, [without_geometry(checker.geometry.missing)])
    return checker


def left_out(checker: Checker) -> list[str]:
    """What the final check does not watch and why: pairs within an arm by name, the rest counted by reason."""
    lines, counts = [], Counter[str]()
    for row in checker.table.left_out:
        if row.by_name:
            lines.append(f"final check leaves out {row.body_i} and {row.body_j}: {row.reason}")
        else:
            counts[row.reason] += 1
    return lines + [
        f"final check leaves out {number} pairs of bodies: {reason}"
        for reason, number in counts.items()
    ]


def refusal(cell: Cell, faults: Sequence[str]) -> InputError:
    """What the checker found wrong with a scene, in the words of the scenario file."""
    return InputError(
        [f"check.enabled = true: {fault}" for fault in faults], file=cell.scenario.file
    )


def without_geometry(missing: Sequence[str]) -> str:
    """The fault of a scene in which arms have parts that the check could not see."""
    return (
        f"the final check has no geometry for {', '.join(missing)}; give them convex geoms of group "
        f"{HOUSING_GROUP}, or set check.enabled = false"
    )


def _exemptions(cell: Cell, d_min_m: float) -> tuple[Exemption, ...]:
    """One for every two things that jobs bring together; the fastest of several jobs sets its cap."""
    sides: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {}
    speed_m_s: dict[str, float] = {}
    tools = {arm.name: cell.model.body(tool_body(cell.model, arm)).name for arm in cell.arms}
    held = instruments_of(cell)
    for arm in cell.scenario.arm:
        for job in arm.job:
            if isinstance(job, (Meet, Exchange)):
                name = window_name(arm.name, job.arm)
                mine, theirs = ((tools[a], *sorted(held[a])) for a in (arm.name, job.arm))
            elif isinstance(job, Fetch):
                name, mine, theirs = (
                    window_name(arm.name, job.instrument),
                    (tools[arm.name],),
                    (job.instrument,),
                )
            else:
                continue
            sides[name] = (mine, theirs)
            speed_m_s[name] = max(job.speed_m_s, speed_m_s.get(name, 0.0))
    return tuple(
        Exemption(
            name=name,
            geoms_i=mine,
            geoms_j=theirs,
            expiry_s=MEETING_S,
            max_closing_m_s=CLOSING_MARGIN * speed_m_s[name],
            d_min_m=d_min_m / 2,
            near_m=MEETING_NEAR_M,
        )
        for name, (mine, theirs) in sides.items()
    )


def instruments_of(cell: Cell) -> dict[str, set[str]]:
    """The instruments that each arm holds at some time of the scenario."""
    held: dict[str, set[str]] = {arm.name: set() for arm in cell.arms}
    for item in cell.instruments:
        if item.held_by is not None:
            held[item.held_by].add(item.name)
    for arm in cell.scenario.arm:
        for job in arm.job:
            if isinstance(job, (Fetch, Exchange)):
                held[arm.name].add(job.instrument)
            if isinstance(job, Exchange):
                held[job.arm].add(job.instrument)
    return held
