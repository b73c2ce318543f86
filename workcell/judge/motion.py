"""How an arm moved: the speed of its fastest point, how far its tool was from its target, how smooth its joints were."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.judge.kinematics import Stretch, length, point_velocity
from workcell.judge.scene import JudgedScene

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ArmMotion:
    """One arm's motion in a run."""

    peak_point_speed_m_s: float
    """Largest speed of any point of its watched geoms and of what it holds."""
    capped_ticks: int | None
    """Ticks in which a point was faster than the cap; None without a cap."""
    target_error_m: float
    """Largest distance of the tool from its target, m: of a support arm the deviation from its path."""
    target_error_rms_m: float
    jerk_rms_rad_s3: float | None
    """Of the true joint velocities' second differences, over all joints and ticks; None in a run of two ticks."""
    jerk_peak_rad_s3: float | None


class MotionWatch:
    """Watches one arm of a run, tick by tick.

    Args:
        scene: The scene.
        arm: Its name.
        geoms: Watched geoms of the arm.
        cap_m_s: Largest speed allowed to its points; None for none.
    """

    def __init__(
        self, scene: JudgedScene, arm: str, geoms: NDArray[np.intp], cap_m_s: float | None
    ):
        self.scene, self.arm, self.cap_m_s = scene, arm, cap_m_s
        model = scene.model
        self._geoms = geoms
        corners = [_corners(model, int(g)) for g in geoms]
        self._place = np.repeat(np.arange(len(geoms)), [len(c) for c in corners])
        self._local = np.concatenate([np.empty((0, 3)), *corners])
        self._radius = np.array([_radius(model, int(g)) for g in geoms])[self._place]
        self._error: list[Array] = []
        self._joints: list[Array] = []
        self._peak_m_s, self._capped = 0.0, 0

    def look(self, ticks: Stretch, target_m: Array) -> None:
        """Take some ticks into account, with the tool's (C, 3) targets in them."""
        scene, model = self.scene, self.scene.model
        self._error.append(length(ticks.site[:, scene.tool_site[self.arm]] - target_m))
        self._joints.append(ticks.qvel[:, scene.dofs[self.arm]])
        if not len(self._local):
            return
        geoms = self._geoms[self._place]
        body = model.geom_bodyid[geoms]
        rotation = ticks.rotation[:, geoms].reshape(len(ticks), -1, 3, 3)
        point = ticks.position[:, geoms] + np.einsum("tcij,cj->tci", rotation, self._local)
        twist = ticks.true[:, body]
        speed = length(point_velocity(twist, ticks.centre[:, body], point))
        fastest = (speed + length(twist[..., :3]) * self._radius).max(axis=1)
        self._peak_m_s = max(self._peak_m_s, float(fastest.max()))
        if self.cap_m_s is not None:
            self._capped += int((fastest > self.cap_m_s * (1.0 + 1e-6)).sum())

    def told(self, period_s: float) -> ArmMotion:
        """What came of it."""
        error, joints = np.concatenate(self._error), np.concatenate(self._joints)
        jerk = np.diff(joints, 2, axis=0) / period_s**2 if len(joints) > 2 else None
        return ArmMotion(
            peak_point_speed_m_s=self._peak_m_s,
            capped_ticks=None if self.cap_m_s is None else self._capped,
            target_error_m=float(error.max(initial=0.0)),
            target_error_rms_m=float(np.sqrt(np.mean(error**2))),
            jerk_rms_rad_s3=None if jerk is None else float(np.sqrt(np.mean(jerk**2))),
            jerk_peak_rad_s3=None if jerk is None else float(np.abs(jerk).max()),
        )


def _corners(model: mujoco.MjModel, geom: int) -> Array:
    """(C, 3) points whose hull, with a ball of `_radius` about each, contains the geom."""
    kind, size = model.geom_type[geom], model.geom_size[geom]
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return np.array([[0.0, 0.0, -size[1]], [0.0, 0.0, size[1]]])
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return np.zeros((1, 3))
    centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
    signs = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T
    return centre + signs * half


def _radius(model: mujoco.MjModel, geom: int) -> float:
    is_round = model.geom_type[geom] in (
        mujoco.mjtGeom.mjGEOM_CAPSULE,
        mujoco.mjtGeom.mjGEOM_SPHERE,
    )
    return float(model.geom_size[geom, 0]) if is_round else 0.0
