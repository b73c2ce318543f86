"""What a scenario must satisfy across its tables, as far as it can be judged without MuJoCo."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from itertools import pairwise
from typing import TYPE_CHECKING

from workcell.errors import did_you_mean
from workcell.scenario.jobs import Exchange, Fetch, Meet, Move, Present, Put
from workcell.scenario.operators import Human, Waypoints
from workcell.scenario.values import LONGEST_PATH_M, MOST_JOBS, MOST_TICKS

if TYPE_CHECKING:
    from workcell.scenario.schema import Arm, Scenario

SCENE_NAMES = ("world", "floor")
"""Names of what every scene has of itself."""
INSTRUMENT_PARTS = ("capsule", "rod", "free")
"""An instrument `x` becomes `x_capsule`, `x_rod` and `x_free` in the scene."""


def fits_together(scenario: Scenario) -> list[str]:
    """Names that clash, names that nothing bears, hands that cannot hold what they should, and runs without end.

    Returns:
        Every fault, naming table, key, value and what is allowed; later groups are judged only where the
        earlier ones are sound.
    """
    faults = [*_names(scenario), *_amounts(scenario), *_lengths(scenario)]
    faults = faults or list(_references(scenario))
    return faults or list(_hands(scenario))


def _names(scenario: Scenario) -> Iterator[str]:
    """Names that clash with each other or with what a scene has of itself."""
    tables = {"arm": scenario.arm, "obstacle": scenario.obstacle, "instrument": scenario.instrument}
    for table, things in tables.items():
        counts = Counter(thing.name for thing in things)
        doubled = [name for name, count in counts.items() if count > 1]
        if doubled:
            yield f"{table} names must be unique, {', '.join(doubled)} occurs more than once"
    owners: dict[str, str] = dict.fromkeys(SCENE_NAMES, "a part of every scene")
    for instrument in scenario.instrument:
        for part in INSTRUMENT_PARTS:
            owners.setdefault(
                f"{instrument.name}_{part}", f"a part of instrument {instrument.name}"
            )
    for table, things in tables.items():
        for name in dict.fromkeys(thing.name for thing in things):
            if name in owners:
                yield f"{name} is the name of {owners[name]} and of {_article(table)}; choose another"
            else:
                owners[name] = _article(table)


def _article(table: str) -> str:
    return f"{'a' if table[0] not in 'aeio' else 'an'} {table}"


def _amounts(scenario: Scenario) -> Iterator[str]:
    """Work without end, or none at all."""
    ticks = scenario.simulation.duration_s / scenario.simulation.period_s
    if not 1 <= round(ticks) <= MOST_TICKS:
        yield (
            f"simulation.duration_s = {scenario.simulation.duration_s:g} is {ticks:.3g} ticks of period_s = "
            f"{scenario.simulation.period_s:g}; allowed is 1 to {MOST_TICKS:,}"
        )
    if not scenario.control.gate and not scenario.check.enabled:
        yield (
            "control.gate = false: allowed only with check.enabled = true, since nothing else would stand behind a strategy"
        )
    for arm in scenario.arm:
        if len(arm.job) * arm.job_repeat > MOST_JOBS:
            yield (
                f"arm.{arm.name}.job_repeat = {arm.job_repeat}: makes {len(arm.job) * arm.job_repeat:,} jobs; "
                f"allowed is {MOST_JOBS:,}"
            )


def _lengths(scenario: Scenario) -> Iterator[str]:
    """Paths so long that following them before the run would take minutes."""
    for arm in scenario.arm:
        lists = [
            (f"job.{k}.waypoints", job.waypoints)
            for k, job in enumerate(arm.job)
            if isinstance(job, Move)
        ]
        if isinstance(arm.operator, Waypoints):
            lists.append(("operator.waypoints", arm.operator.waypoints))
        if isinstance(arm.operator, Human):
            lists.append(("operator.sites", arm.operator.sites))
        whole_m = 0.0
        for key, waypoints in lists:
            places = [waypoint.position_m for waypoint in waypoints]
            whole_m += sum(math.dist(a, b) for a, b in pairwise(places))
            if whole_m > LONGEST_PATH_M:
                yield (
                    f"arm.{arm.name}.{key}: makes {whole_m:.0f} m of waypoints for this arm; allowed is {LONGEST_PATH_M:g} m"
                )
                break


def _references(scenario: Scenario) -> Iterator[str]:
    """Names of arms, obstacles and instruments that nothing bears."""
    arms = [arm.name for arm in scenario.arm]
    obstacles = [obstacle.name for obstacle in scenario.obstacle]
    instruments = {item.name: item for item in scenario.instrument}
    for item in scenario.instrument:
        where = f"instrument {item.name}"
        yield from _unknown(item.held_by, arms, f"{where}: held_by", "an arm")
        for support in item.rests_on:
            yield from _unknown(support, obstacles, f"{where}: rests_on", "an obstacle")
    for arm in scenario.arm:
        others = [name for name in arms if name != arm.name]
        for index, job in enumerate(arm.job):
            where = _job_of(arm, index)
            if isinstance(job, (Meet, Present, Exchange)):
                yield from _unknown(job.arm, others, f"{where}: arm", "another arm")
            if isinstance(job, (Fetch, Exchange, Put)):
                yield from _unknown(
                    job.instrument, list(instruments), f"{where}: instrument", "an instrument"
                )
            if (
                isinstance(job, Put)
                and job.instrument in instruments
                and instruments[job.instrument].position_m is None
            ):
                yield f"{where}: {job.instrument} has no place of its own (position_m)"


def _unknown(name: str | None, allowed: list[str], where: str, what: str) -> Iterator[str]:
    if name is not None and name not in allowed:
        yield (
            f"{where}: {name!r} is not {what} of this scenario; allowed: "
            f"{', '.join(allowed) or 'there is none'}{did_you_mean(name, allowed)}"
        )


def _hands(scenario: Scenario) -> Iterator[str]:
    """Follow every arm's jobs with the instruments: nobody gives what it does not hold, or takes with a full hand.

    The first fault ends it, since what follows depends on it.
    """
    holder: dict[str, str | None] = {}
    for item in scenario.instrument:
        if item.held_by is not None and item.held_by in holder.values():
            yield f"instrument {item.name}: {item.held_by} holds another one already"
            return
        holder[item.name] = item.held_by
    for arm in scenario.arm:
        for index, job in enumerate(arm.job * arm.job_repeat):
            if not isinstance(job, (Fetch, Exchange, Put)):
                continue
            fault = _carry(holder, arm.name, job)
            if fault:
                yield f"{_job_of(arm, index % len(arm.job))}: {fault}"
                return


def _job_of(arm: Arm, index: int) -> str:
    return f"arm {arm.name}: job {index} ({arm.job[index].kind})"


def _carry(holder: dict[str, str | None], arm: str, job: Fetch | Exchange | Put) -> str | None:
    """Let one job change who holds what; why it cannot."""
    giver: str | None
    taker: str | None
    if isinstance(job, Fetch):
        giver, taker = None, arm
    elif isinstance(job, Put):
        giver, taker = arm, None
    else:
        giver, taker = (arm, job.arm) if job.direction == "give" else (job.arm, arm)
    if holder[job.instrument] != giver:
        has = holder[job.instrument] or "nobody"
        return f"{job.instrument} must be held by {giver or 'nobody'} then, but {has} holds it"
    if taker is not None and taker in holder.values():
        return f"{taker} holds an instrument already"
    holder[job.instrument] = taker
    return None
