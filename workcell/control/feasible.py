"""Can the scenario be carried out at all: are its poses within reach, its speeds within the joints?

Judged before the first tick, with the arms' own kinematics: each scripted path is followed offline; `reaction`
adds what delay asks of gains and of t_min. Speed is judged of waypoints that an operator follows, since nothing
slows those down; jobs are slowed down where the joints cannot keep up, and what a simulated person draws is only
known as it happens.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import mink
import numpy as np
from numpy.typing import NDArray

from workcell import scenario
from workcell.control import reaction
from workcell.control.criteria import NullspaceObjective
from workcell.control.ik import DIRECTIONS, ArmIk, ToolTask
from workcell.control.reach import REACHED_M, REACHED_RAD
from workcell.errors import InputError
from workcell.motion.operators import faults as operator_faults
from workcell.motion.operators import make_operator
from workcell.motion.path import PathGeometry, Target, path_through, standing
from workcell.scene.addresses import ArmAddresses
from workcell.scene.cell import Cell

LAG_M = 0.02
"""A path's speed is one that can be followed while the tool stays this near: farther away the controller itself counts
an arm as off its path (REJOIN_M)."""
LONGEST_FOLLOWED_S = 300.0
"""So much of an operator's path is followed before a run; a few seconds of work."""
_NUMERALS = ("no", "one", "two", "three", "four", "five", "six")
_STEP_M = 0.02
_STEP_S = 0.02
_ITERATIONS = 30
_SPEED_TRIALS = 10
_SLOWER = 0.8


def check(cell: Cell) -> None:
    """Refuse paths out of reach, operators' paths too fast for their joints, and gains and times that delay does not allow.

    Raises:
        InputError: every fault found, naming arm, job, the length along its path and the remaining error.
    """
    faults: list[str] = []
    belief = mink.Configuration(cell.model)
    for arm, addresses in zip(cell.scenario.arm, cell.arms, strict=True):
        faults += _operator_faults(cell, arm, addresses, belief)
        unreached = list(_out_of_reach(cell, arm, addresses, belief))
        # Where a path cannot be followed at all, no speed is worth a word.
        faults += unreached or _too_fast(cell, arm, addresses)
    faults += reaction.faults(cell)
    if faults:
        raise InputError(faults, file=cell.scenario.file)


def _operator_faults(
    cell: Cell, arm: scenario.Arm, addresses: ArmAddresses, belief: mink.Configuration
) -> list[str]:
    """What the arm's operator itself finds wrong with its input."""
    if arm.operator is None:
        return []
    cell.place_home(belief.data)
    belief.update()
    pose = belief.get_transform_frame_to_world(addresses.tool_site_name, "site")
    simulation = cell.scenario.simulation
    found = operator_faults(
        arm.operator,
        pose.translation(),
        pose.rotation().wxyz,
        duration_s=simulation.duration_s,
        period_s=simulation.period_s,
        name=arm.name,
        home_rad=tuple(addresses.home_rad.tolist()),
        joints=tuple(joint.removeprefix(f"{arm.name}/") for joint in addresses.joints),
    )
    return [f"arm.{arm.name}.operator.{fault}" for fault in found]


def _out_of_reach(
    cell: Cell, arm: scenario.Arm, addresses: ArmAddresses, belief: mink.Configuration
) -> Iterator[str]:
    """Follow the arm's waypoints from its home configuration, joint limits kept."""
    cell.place_home(belief.data)
    belief.update()
    task = ToolTask(addresses.tool_site_name, gain_per_s=1.0, dt_s=1.0)
    pose = belief.get_transform_frame_to_world(addresses.tool_site_name, "site")
    position, wxyz = pose.translation(), pose.rotation().wxyz
    for key, waypoints, directions in _waypoint_lists(arm):
        geometry = _curve(waypoints, tuple(position), tuple(wxyz))
        for s_m in np.linspace(0.0, geometry.length_m, 2 + int(geometry.length_m / _STEP_M)):
            error = _move_to(belief, task, addresses, standing(*geometry.pose(s_m)), directions)
            if np.linalg.norm(error[:3]) > REACHED_M or np.linalg.norm(error[3:]) > REACHED_RAD:
                at = ", ".join(f"{x:.3f}" for x in geometry.pose(s_m)[0])
                yield (
                    f"arm.{arm.name}.{key}: out of reach at ({at}) m, {s_m:.2f} of {geometry.length_m:.2f} m along the path: "
                    f"the tool stays {np.linalg.norm(error[:3]):.3f} m and {np.linalg.norm(error[3:]):.3f} rad away"
                    + _too_few_joints(addresses, directions)
                )
                return
        position, wxyz = geometry.pose(geometry.length_m)


def _too_few_joints(addresses: ArmAddresses, directions: int) -> str:
    """What an arm with fewer joints than its task has directions cannot help, and what it can be asked instead."""
    joints = len(addresses.joints)
    if joints >= directions:
        return ""
    fewer = [f"'{task}' has {_NUMERALS[n]}" for task, n in DIRECTIONS.items() if n < directions]
    return (
        f"; the task has {_NUMERALS[directions]} directions, the arm {_NUMERALS[joints]} joint{'s' * (joints > 1)}: "
        "only poses on the way that its joints allow can be followed"
        + (f"; arm.{addresses.name}.task = {', '.join(fewer)}" if fewer else "")
    )


def _waypoint_lists(
    arm: scenario.Arm,
) -> Iterator[tuple[str, tuple[scenario.Waypoint, ...], int]]:
    """Key and waypoints of every path that is known beforehand, and how many directions of the tool are asked for."""
    if isinstance(arm.operator, scenario.Waypoints):
        yield "operator.waypoints", arm.operator.waypoints, DIRECTIONS[arm.task]
    elif isinstance(arm.operator, scenario.Human):
        yield "operator.sites", arm.operator.sites, DIRECTIONS[arm.task]
    for index, job in enumerate(arm.job):
        if isinstance(job, scenario.Move):
            directions = DIRECTIONS[job.task or arm.task]
            directions = min(directions, 5) if job.free_rotation else directions
            yield f"job.{index}.waypoints", job.waypoints, directions


def _move_to(
    belief: mink.Configuration,
    task: ToolTask,
    addresses: ArmAddresses,
    pose: Target,
    directions: int = 6,
) -> NDArray[np.float64]:
    """Newton steps towards a pose, clipped to the joint ranges.

    Args:
        belief: The state; moved.
        task: The tool's task.
        addresses: The arm.
        pose: Where the tool is wanted.
        directions: How many of the task's six count, as in `ik.DIRECTIONS`.

    Returns:
        (directions,) the remaining tool error: m, then rad.
    """
    task.follow(pose)
    error = task.compute_error(belief)[:directions]
    for _ in range(_ITERATIONS):
        if np.abs(error).max() < REACHED_M / 10:
            break
        step = np.linalg.lstsq(
            task.compute_jacobian(belief)[:directions, addresses.dofs], -error, rcond=1e-3
        )[0]
        q = belief.data.qpos.copy()
        q[addresses.qpos] = np.clip(
            q[addresses.qpos] + np.clip(step, -0.2, 0.2), addresses.lower_rad, addresses.upper_rad
        )
        belief.update(q)
        error = task.compute_error(belief)[:directions]
    return error


@lru_cache(maxsize=4)
def _curve(
    waypoints: tuple[scenario.Waypoint, ...],
    position_m: tuple[float, ...],
    wxyz: tuple[float, ...],
) -> PathGeometry:
    """`path_through`; an operator's waypoints are asked for twice, for their reach and their length."""
    return path_through(waypoints, np.array(position_m), np.array(wxyz))


def _too_fast(cell: Cell, arm: scenario.Arm, addresses: ArmAddresses) -> Iterator[str]:
    """An operator's waypoints at their speed, refused with the speed that would do."""
    operator = arm.operator
    if not isinstance(operator, scenario.Waypoints):
        return
    if largest_lag(cell, addresses, operator, quick=True).error_m <= LAG_M / 2:
        return
    lag = largest_lag(cell, addresses, operator)
    if lag.error_m <= LAG_M:
        return
    advice = f"no lower speed mends that at acceleration_m_s2 = {operator.acceleration_m_s2:g}"
    speed = operator.speed_m_s
    for _ in range(_SPEED_TRIALS):
        speed *= _SLOWER
        slower = operator.model_copy(update={"speed_m_s": speed})
        if largest_lag(cell, addresses, slower).error_m <= LAG_M:
            advice = f"{speed:.2g} m/s would do"
            break
    where = ", ".join(f"{x:.3f}" for x in lag.position_m)
    yield (
        f"arm.{arm.name}.operator.speed_m_s = {operator.speed_m_s:g}: too fast for the joints, whose limits leave the tool "
        f"{1e3 * lag.error_m:.0f} mm behind near ({where}) m; allowed is {1e3 * LAG_M:g} mm, and {advice}"
    )


@dataclass(frozen=True)
class Lag:
    """How far a tool falls behind what leads it."""

    error_m: float
    """Largest distance to the target."""
    position_m: NDArray[np.float64]
    """(3,) where the target then is."""


def largest_lag(
    cell: Cell, addresses: ArmAddresses, operator: scenario.Waypoints, *, quick: bool = False
) -> Lag:
    """Follow an operator's waypoints as the controller would, nothing else in the cell and no self-motion wanted.

    Args:
        cell: Its arms.
        addresses: The arm.
        operator: Whose waypoints are followed.
        quick: Solve the program only where a joint limit binds, else move as little as the tool needs, which
            is its answer but for `LEAST_MOTION_DAMPING`: half the time, and off by a hundred-thousandth at usual poses.
    """
    belief = mink.Configuration(cell.model)
    cell.place_home(belief.data)
    belief.update()
    pose = belief.get_transform_frame_to_world(addresses.tool_site_name, "site")
    start = pose.translation(), pose.rotation().wxyz
    step_s = max(_STEP_S, cell.period_s)
    control = cell.scenario.control
    ik = ArmIk(
        addresses,
        nv=cell.model.nv,
        dt_s=step_s,
        task_gain_per_s=control.task_gain_per_s,
        criterion_gain=0.0,
    )
    task = next(arm.task for arm in cell.scenario.arm if arm.name == addresses.name)
    n = len(addresses.dofs)
    nothing = NullspaceObjective.nothing(n)
    no_rows = np.zeros((0, n)), np.zeros(0)
    # One leg back and one forth are all there is: further ones repeat them.
    once = operator.model_copy(update={"start_s": 0.0, "repeat": min(operator.repeat, 2)})
    driver = make_operator(once, *start)
    velocity, worst = np.zeros(n), Lag(0.0, start[0])
    followed_s = min(
        _duration_s(once, *start), cell.scenario.simulation.duration_s, LONGEST_FOLLOWED_S
    )
    for k in range(round(followed_s / step_s) + 1):
        target = driver.setpoint(k * step_s).target
        tool = belief.data.site_xpos[addresses.tool_site]
        error_m = float(np.linalg.norm(tool - target.position_m))
        if error_m > worst.error_m:
            worst = Lag(error_m, target.position_m)
        least = ik.aim(belief, target, task=task)
        allowed = ik.followed(belief, velocity, least) if quick else None
        if allowed is None or not np.array_equal(allowed, least):
            allowed = ik.solve(belief, velocity, nothing, *no_rows).velocity_rad_s
        velocity = allowed
        q = belief.data.qpos.copy()
        q[addresses.qpos] += step_s * velocity
        belief.update(q)
    return worst


def _duration_s(
    operator: scenario.Waypoints, position_m: NDArray[np.float64], wxyz: NDArray[np.float64]
) -> float:
    """An upper bound of the time the operator moves: every stretch at its speed, and one ramp up and down each."""
    waypoints = _curve(operator.waypoints, tuple(position_m), tuple(wxyz)).length_m
    # A smooth step loses 1.5 v / a to its two ramps.
    ramps_s = 1.5 * operator.speed_m_s / operator.acceleration_m_s2
    stretch_s = waypoints / operator.speed_m_s + ramps_s + operator.pause_s
    return (1 + operator.repeat) * stretch_s
