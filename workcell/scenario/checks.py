"""What a scenario must satisfy across its tables, as far as it can be judged without MuJoCo."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from workcell.scenario.jobs import Exchange, Fetch, Meet, Present, Put

if TYPE_CHECKING:
    from workcell.scenario.schema import Scenario


def fits_together(scenario: Scenario) -> None:
    """Refuse names that clash, names that nothing bears, and hands that cannot hold what they should.

    Raises:
        ValueError: with the first fault.
    """
    _unique(scenario.arm, "arm")
    _unique(scenario.obstacle, "obstacle")
    _unique(scenario.instrument, "instrument")
    arms = [arm.name for arm in scenario.arm]
    for thing in (*scenario.obstacle, *scenario.instrument):
        if thing.name in arms:
            raise ValueError(f"{thing.name} is the name of an arm and of an obstacle or instrument")
    obstacles = [obstacle.name for obstacle in scenario.obstacle]
    holder: dict[str, str | None] = {}
    for item in scenario.instrument:
        _known(item.held_by, arms, f"instrument {item.name}: held_by", "an arm")
        for support in item.rests_on:
            _known(support, obstacles, f"instrument {item.name}: rests_on", "an obstacle")
        if item.held_by is not None and item.held_by in holder.values():
            raise ValueError(f"instrument {item.name}: {item.held_by} holds another one already")
        holder[item.name] = item.held_by
    for arm in scenario.arm:
        others = [name for name in arms if name != arm.name]
        for index, job in enumerate(arm.job * arm.job_repeat):
            where = f"arm {arm.name}: job {index % len(arm.job)} ({job.kind})"
            if isinstance(job, (Meet, Present, Exchange)):
                _known(job.arm, others, f"{where}: arm", "another arm")
            if isinstance(job, (Fetch, Exchange, Put)):
                _known(job.instrument, list(holder), f"{where}: instrument", "an instrument")
                if isinstance(job, Put) and next(
                    item.position_m is None
                    for item in scenario.instrument
                    if item.name == job.instrument
                ):
                    raise ValueError(
                        f"{where}: {job.instrument} has no place of its own (position_m)"
                    )
                _carry(holder, arm.name, job, where)


def _unique(items: tuple[Any, ...], what: str) -> None:
    names = [item.name for item in items]
    doubled = sorted({name for name in names if names.count(name) > 1})
    if doubled:
        raise ValueError(f"{what} names must be unique, {', '.join(doubled)} occurs more than once")


def _known(name: str | None, allowed: list[str], where: str, what: str) -> None:
    if name is not None and name not in allowed:
        raise ValueError(
            f"{where}: {name!r} is not {what} of this scenario; allowed: {', '.join(allowed) or 'there is none'}"
        )


def _carry(
    holder: dict[str, str | None], arm: str, job: Fetch | Exchange | Put, where: str
) -> None:
    """Follow one arm's jobs with the instruments: nobody gives what it does not hold, or takes with a full hand."""
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
        raise ValueError(
            f"{where}: {job.instrument} must be held by {giver or 'nobody'} then, but {has} holds it"
        )
    if taker is not None and taker in holder.values():
        raise ValueError(f"{where}: {taker} holds an instrument already")
    holder[job.instrument] = taker
