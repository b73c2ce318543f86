"""Can an arm come to what its jobs meet: another arm's tool, an instrument that lies, the place of one to be put back?

Judged before the first tick. The place of a tool that moves is known only as it moves; such a job is refused where
none of the places at which that tool is known to work can be reached. Only positions are judged, from
several starts, with as much room as a held instrument and a presentation's distance give: a job that is refused
here could not have been done. A job that the run ends before is not refused.
"""

from __future__ import annotations

from collections.abc import Iterator

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell import scenario
from workcell.errors import InputError
from workcell.scene.addresses import ArmAddresses
from workcell.scene.cell import HELD_GAP_M, Cell
from workcell.scene.hand import around_m

SLACK_M = 0.02
"""Beyond what is held: two tools meet a d_min apart, and hands are this large."""
STARTS = 6
"""Configurations from which a place is tried, beside home; chosen so that every shipped job is found reachable
from the first or second."""
_STEPS = 60
_LONGEST_STEP = 0.3


def check(cell: Cell) -> None:
    """Refuse jobs that meet what the arm cannot come near.

    Raises:
        InputError: naming arm, job, what it is to meet, and how near the tool comes.
    """
    data = mujoco.MjData(cell.model)
    cell.place_home(data)
    mujoco.mj_kinematics(cell.model, data)
    tools = {arm.name: data.site_xpos[arm.tool_site].copy() for arm in cell.arms}
    faults = [
        fault
        for arm, addresses in zip(cell.scenario.arm, cell.arms, strict=True)
        for fault in _of_arm(cell, arm, addresses, tools)
    ]
    if faults:
        raise InputError(faults, file=cell.scenario.file)


def _of_arm(
    cell: Cell,
    arm: scenario.Arm,
    addresses: ArmAddresses,
    tools: dict[str, NDArray[np.float64]],
) -> Iterator[str]:
    judged: set[tuple[str, float]] = set()
    end_s = cell.scenario.simulation.duration_s
    for index, (job, begins_s, here_m) in enumerate(_begins(arm, tools[arm.name])):
        found = _meets(cell, arm, job, tools)
        if found is None:
            continue
        what, places, slack_m = found
        if (what, slack_m) in judged:
            continue
        judged.add((what, slack_m))
        left_m = min(_left_m(cell, addresses, place, slack_m) for place in places)
        way_m = 0.0
        if here_m is not None:
            way_m = max(0.0, min(float(np.linalg.norm(p - here_m)) for p in places) - left_m)
        # Where the run ends before the tool could be as near as it comes, nobody sees a difference.
        if left_m > slack_m and begins_s + _least_s(way_m, job) < end_s:
            at = ", ".join(f"{x:.3f}" for x in places[0])
            yield (
                f"arm.{arm.name}.job.{index} ({job.kind}): {what} at ({at}) m is out of reach: the tool stays "
                f"{left_m:.3f} m away; allowed is {slack_m:.3f} m"
            )


def _begins(
    arm: scenario.Arm, tool_m: NDArray[np.float64]
) -> Iterator[tuple[scenario.Job, float, NDArray[np.float64] | None]]:
    """Each job, the time before which it cannot begin, and where the tool then is; None where nobody knows yet."""
    now_s, here_m = 0.0, tool_m
    for job in arm.job:
        yield job, now_s, here_m
        if isinstance(job, scenario.Wait):
            now_s += job.duration_s
        elif isinstance(job, scenario.Move):
            points_m = [np.array(point.position_m) for point in job.waypoints]
            way_m = points_m if here_m is None else [here_m, *points_m]
            length_m = float(np.linalg.norm(np.diff(way_m, axis=0), axis=1).sum())
            now_s += _least_s(length_m, job)
            here_m = way_m[-1]
        else:
            here_m = None


def _least_s(length_m: float, job: scenario.Job) -> float:
    """Time that a straight way takes from rest to rest within a job's speed and acceleration."""
    if isinstance(job, scenario.Wait):
        return 0.0
    if length_m < job.speed_m_s**2 / job.acceleration_m_s2:
        return 2.0 * float(np.sqrt(length_m / job.acceleration_m_s2))
    return length_m / job.speed_m_s + job.speed_m_s / job.acceleration_m_s2


def _meets(
    cell: Cell, arm: scenario.Arm, job: scenario.Job, tools: dict[str, NDArray[np.float64]]
) -> tuple[str, list[NDArray[np.float64]], float] | None:
    """What a job goes to, every place where that is known to be, and how near the tool has to come."""
    items = {item.name: item for item in cell.scenario.instrument}
    longest_m = max((2 * (x.half_length_m + x.radius_m) for x in items.values()), default=0.0)
    if isinstance(job, (scenario.Fetch, scenario.Put)):
        item = items[job.instrument]
        if item.position_m is None:
            return None
        own = next(each for each in cell.arms if each.name == arm.name)
        slack_m = SLACK_M + HELD_GAP_M + longest_m + _hand_m(cell, own)
        return f"instrument {item.name}", [np.array(item.position_m)], slack_m
    if not isinstance(job, (scenario.Meet, scenario.Present, scenario.Exchange)):
        return None
    other = next(x for x in cell.scenario.arm if x.name == job.arm)
    places = [tools[other.name]]
    match other.operator:
        case scenario.Hold():
            pass
        case scenario.Waypoints():
            places += [np.array(x.position_m) for x in other.operator.waypoints]
        case scenario.Human():
            places += [np.array(x.position_m) for x in other.operator.sites]
        case _:  # it may go anywhere
            return None
    slack_m = SLACK_M + cell.scenario.control.d_min_m
    slack_m += sum(_hand_m(cell, each) for each in cell.arms if each.name in (arm.name, other.name))
    if items:
        slack_m += HELD_GAP_M + longest_m
    if isinstance(job, scenario.Present):
        slack_m += job.distance_m
    return f"the tool of {other.name}", places, slack_m


def _hand_m(cell: Cell, arm: ArmAddresses) -> float:
    """How far a hand reaches around its tool point: what it meets comes no nearer to that point."""
    data = mujoco.MjData(cell.model)
    mujoco.mj_kinematics(cell.model, data)
    return around_m(cell.model, data, arm)


def _left_m(cell: Cell, arm: ArmAddresses, place_m: NDArray[np.float64], enough_m: float) -> float:
    """Smallest distance (m) of an arm's tool from a place, over several starts; the first that is enough ends the search."""
    data = mujoco.MjData(cell.model)
    random = np.random.default_rng(0)
    low = np.maximum(arm.lower_rad, -np.pi)
    high = np.minimum(arm.upper_rad, np.pi)
    starts = [np.asarray(arm.home_rad)]
    starts += [low + (high - low) * random.random(len(low)) for _ in range(STARTS)]
    nearest_m = np.inf
    for start in starts:
        cell.place_home(data)
        nearest_m = min(nearest_m, _descend(cell, arm, data, start, place_m, enough_m))
        if nearest_m <= enough_m:
            break
    return float(nearest_m)


def _descend(
    cell: Cell,
    arm: ArmAddresses,
    data: mujoco.MjData,
    start: NDArray[np.float64],
    place_m: NDArray[np.float64],
    enough_m: float,
) -> float:
    """Damped Newton steps towards a place, clipped to the joint ranges; the smallest distance on the way."""
    jacobian = np.empty((3, cell.model.nv))
    q, best_m = start.copy(), np.inf
    for _ in range(_STEPS):
        data.qpos[arm.qpos] = q
        mujoco.mj_kinematics(cell.model, data)
        mujoco.mj_comPos(cell.model, data)
        error = place_m - data.site_xpos[arm.tool_site]
        best_m = min(best_m, float(np.linalg.norm(error)))
        if best_m <= enough_m:
            break
        mujoco.mj_jacSite(cell.model, data, jacobian, None, arm.tool_site)
        rows = jacobian[:, arm.dofs]
        step = rows.T @ np.linalg.solve(rows @ rows.T + 1e-4 * np.eye(3), error)
        longest = float(np.abs(step).max())
        q = np.clip(
            q + step * min(1.0, _LONGEST_STEP / max(longest, 1e-12)), arm.lower_rad, arm.upper_rad
        )
    return best_m
