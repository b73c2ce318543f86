"""Can the scenario be carried out at all: are its poses within reach, does braking fit into t_min?

Judged before the first tick, with the arms' own kinematics: each scripted path is followed offline,
and t_min is held against the time the slowest braking direction needs (theory: section 5).
"""

from __future__ import annotations

from collections.abc import Iterator

import mink
import numpy as np
from numpy.typing import NDArray

from workcell import scenario
from workcell.control.ik import ToolTask
from workcell.control.scaling import smallest_t_min
from workcell.errors import InputError
from workcell.motion.operator import path_through
from workcell.motion.path import PathGeometry, standing
from workcell.scene.cell import Cell
from workcell.scene.handles import ArmHandles

REACHED_M = 2e-3
REACHED_RAD = 1e-2
"""A pose counts as reached within these; chosen far below what a watched capsule is loose by."""
_STEP_M = 0.02
_ITERATIONS = 30


def check(cell: Cell) -> None:
    """Refuse paths out of reach and a t_min too small to brake in.

    Raises:
        InputError: every fault found, naming arm, job, the length along its path and the remaining error.
    """
    faults: list[str] = []
    for arm, handles in zip(cell.scenario.arm, cell.arms, strict=True):
        faults += _out_of_reach(cell, arm, handles)
        if arm.job:
            faults += _no_room_to_brake(cell, arm, handles)
    if faults:
        raise InputError(faults, file=cell.scenario.file)


def _out_of_reach(cell: Cell, arm: scenario.Arm, handles: ArmHandles) -> Iterator[str]:
    """Follow the arm's waypoints from its home configuration, joint limits kept."""
    belief = mink.Configuration(cell.model)
    cell.place_home(belief.data)
    belief.update()
    task = ToolTask(handles.tool_site_name, gain_per_s=1.0, dt_s=1.0)
    pose = belief.get_transform_frame_to_world(handles.tool_site_name, "site")
    position, wxyz = pose.translation(), pose.rotation().wxyz
    for key, waypoints in _waypoint_lists(arm):
        geometry = path_through(waypoints, position, wxyz)
        for s_m in np.linspace(0.0, geometry.length_m, 2 + int(geometry.length_m / _STEP_M)):
            error = _move_to(belief, task, handles, geometry, s_m)
            if np.linalg.norm(error[:3]) > REACHED_M or np.linalg.norm(error[3:]) > REACHED_RAD:
                at = ", ".join(f"{x:.3f}" for x in geometry.pose(s_m)[0])
                yield (
                    f"arm.{arm.name}.{key}: out of reach at ({at}) m, {s_m:.2f} of {geometry.length_m:.2f} m along the path: "
                    f"the tool stays {np.linalg.norm(error[:3]):.3f} m and {np.linalg.norm(error[3:]):.3f} rad away"
                )
                return
        position, wxyz = geometry.pose(geometry.length_m)


def _waypoint_lists(arm: scenario.Arm) -> Iterator[tuple[str, tuple[scenario.Waypoint, ...]]]:
    if isinstance(arm.operator, scenario.Waypoints):
        yield "operator.waypoints", arm.operator.waypoints
    elif isinstance(arm.operator, scenario.Human):
        yield "operator.sites", arm.operator.sites
    for index, job in enumerate(arm.job):
        if isinstance(job, scenario.Move):
            yield f"job.{index}.waypoints", job.waypoints


def _move_to(
    belief: mink.Configuration,
    task: ToolTask,
    handles: ArmHandles,
    geometry: PathGeometry,
    s_m: float,
) -> NDArray[np.float64]:
    """Newton steps towards a pose, clipped to the joint ranges; returns the remaining tool error (6,)."""
    task.follow(standing(*geometry.pose(s_m)))
    for _ in range(_ITERATIONS):
        error = task.compute_error(belief)
        if np.abs(error).max() < REACHED_M / 10:
            break
        step = np.linalg.lstsq(task.compute_jacobian(belief)[:, handles.dofs], -error, rcond=1e-3)[
            0
        ]
        q = belief.data.qpos.copy()
        q[handles.qpos] = np.clip(
            q[handles.qpos] + np.clip(step, -0.2, 0.2), handles.lower_rad, handles.upper_rad
        )
        belief.update(q)
    return task.compute_error(belief)


def _no_room_to_brake(cell: Cell, arm: scenario.Arm, handles: ArmHandles) -> Iterator[str]:
    control = cell.scenario.control
    speed = max(
        (job.speed_m_s for job in arm.job if not isinstance(job, scenario.Wait)), default=0.0
    )
    others_move = any(
        other.operator is not None and not isinstance(other.operator, scenario.Hold)
        for other in cell.scenario.arm
    )
    needed = smallest_t_min(
        cell.period_s + control.reaction_s,
        speed,
        braking_deceleration_m_s2(cell, handles),
        other_keeps_coming=others_move,
    )
    if control.t_min_s < needed:
        yield (
            f"control.t_min_s = {control.t_min_s:g}: too small for arm {arm.name} to brake in from {speed:g} m/s; "
            f"allowed is {needed:.3f} s or more, or a lower speed_m_s"
        )


def braking_deceleration_m_s2(cell: Cell, handles: ArmHandles) -> float:
    """Deceleration of the tool along its path that the joints can give in the least favourable of the six axis directions, at home."""
    belief = mink.Configuration(cell.model)
    cell.place_home(belief.data)
    belief.update()
    jacobian = belief.get_frame_jacobian(handles.tool_site_name, "site")[:3, handles.dofs]
    joint_rates = np.linalg.pinv(
        jacobian, rcond=1e-3
    )  # (n, 3): joint velocities for 1 m/s along each axis
    with np.errstate(divide="ignore"):
        return float(np.min(handles.acceleration_limit_rad_s2[:, None] / np.abs(joint_rates)))
