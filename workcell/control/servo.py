"""Joint velocity commands -> actuator controls.

A position servo gets the integral of the command plus a lead kv/kp times the command, so that its
force is kp (q_ref - q) + kv (q̇_ref - q̇): it tracks a constant velocity without lag. A velocity
servo gets the command itself.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.scene.addresses import ArmAddresses

LARGEST_LAG_RAD = 0.05
"""A reference farther from the joint than this has lost it (a blocked or saturated joint); it is then
led back, so that a freed joint does not leap. Chosen well above the tracking error of a healthy servo."""


class ServoCommand:
    """Integrates the references of one arm's servos and writes their controls."""

    def __init__(self, arm: ArmAddresses, *, dt_s: float):
        self._arm = arm
        self._dt_s = dt_s
        self._position = np.array([servo.kind == "position" for servo in arm.servos])
        self._all_position = bool(self._position.all())
        self._lead_s = np.array([servo.lead_s for servo in arm.servos])
        self._actuators = np.array([servo.actuator for servo in arm.servos], dtype=np.intp)
        self._reference: NDArray[np.float64] | None = None

    def write(
        self, data: mujoco.MjData, q_rad: NDArray[np.float64], command_rad_s: NDArray[np.float64]
    ) -> bool:
        """Write one tick's controls.

        Args:
            data: Plant data whose `ctrl` is written.
            q_rad: (n,) measured joint positions.
            command_rad_s: (n,) commanded velocities.

        Returns:
            Whether a reference had lost its joint and was led back.
        """
        if (
            not self._actuators.size
        ):  # An arm that is only moved kinematically may have no actuators.
            return False
        if self._reference is None:
            self._reference = q_rad.copy()
        wanted = self._reference = self._reference + command_rad_s * self._dt_s
        lost = False
        if not np.abs(wanted - q_rad).max() < LARGEST_LAG_RAD:
            self._reference = np.clip(wanted, q_rad - LARGEST_LAG_RAD, q_rad + LARGEST_LAG_RAD)
            lost = bool((self._position & (self._reference != wanted)).any())
        led = self._reference + self._lead_s * command_rad_s
        data.ctrl[self._actuators] = (
            led if self._all_position else np.where(self._position, led, command_rad_s)
        )
        return lost
