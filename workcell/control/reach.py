"""What an arm does with a target beyond its reach: it stretches to the nearest place there is, and stands.

Following the tool error would not end: near a stretched pose small errors ask for fast joints, whose acceleration is
limited, and the arm swings. So the nearest configuration is sought first, by damped Gauss-Newton steps from where the
arm is (Levenberg-Marquardt), and then the joints go there, each no faster than it can stop in time:

    minimise  |p* - p(q)|² + ℓ² |turn from R(q) to R*|²   within the joint ranges,   ℓ = TURN_LENGTH_M_PER_RAD
    step      (JᵀJ + μ) Δq = Jᵀ e,   μ = |e| times a length: what JᵀJ leaves out of the second derivative of a stretched arm
"""

from __future__ import annotations

from typing import NamedTuple

import mink
import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.control.ik import DIRECTIONS
from workcell.control.laws import gate_box
from workcell.motion.orientation import pointing, turned_towards
from workcell.motion.path import TURN_LENGTH_M_PER_RAD, Target
from workcell.scene.addresses import ArmAddresses

Array = NDArray[np.float64]

REACHED_M, REACHED_RAD = 2e-3, 1e-2
"""A target counts as reached within these; chosen far below what a watched capsule is loose by."""
LEFT_SHARE = 0.5
"""And a target that was out of reach only within this share of them: a hand at the edge does not switch the arm to and fro."""
STEPS = 4
"""Gauss-Newton steps a tick, each from where the last one ended."""
FOUND_RAD, FOUND_SHARE = 1e-5, 1e-3
"""A step below this, or one that would mend less than this share of the error's square, finds nothing nearer."""
STOPPING_SHARE = 0.8
"""Part of a joint's deceleration with which it is brought to rest; the rest is for a place that moves yet."""
CATCH_UP_S = 0.3
"""How long a target must have been back in reach before its error is followed again where that takes the joints' limits."""


class OutOfReach(NamedTuple):
    """What is done with a target that cannot be reached."""

    velocity_rad_s: Array
    """(n,) towards the nearest configuration."""
    left_m: float
    """How far from the target the tool will stay."""


class Reach:
    """Looks after one arm's targets.

    Args:
        model: The model.
        arm: Its addresses and limits.
        period_s: Control period.
        gain_per_s: Rate at which errors are made good.
    """

    def __init__(
        self, model: mujoco.MjModel, arm: ArmAddresses, *, period_s: float, gain_per_s: float
    ):
        self._arm, self._period_s, self._gain_per_s = arm, period_s, gain_per_s
        self._trial = mink.Configuration(model)
        self._deceleration = STOPPING_SHARE * arm.acceleration_limit_rad_s2
        self._length_m = 0.0
        """Length of the arm from its base to its tool as far as it has been seen stretched."""
        self._nearest: Array | None = None
        self._found = False
        self._out = False
        self._back_s = 0.0
        """How long the target has been back in reach."""
        self._damping = 1.0

    def has_reached(self, errors: tuple[float, float]) -> bool:
        """Whether the tool is where it is wanted, by its errors in m and rad, and nothing has to be looked for."""
        reached = not self._out and errors[0] <= REACHED_M and errors[1] <= REACHED_RAD
        if reached:
            self._nearest = None
        return reached

    def follow(
        self,
        configuration: mink.Configuration,
        target: Target,
        task: str,
        *,
        errors: tuple[float, float],
        box: tuple[Array, Array],
        eased: bool,
    ) -> OutOfReach | None:
        """What to do in this tick; None where the target can be reached and its error is to be followed.

        Args:
            configuration: The controller's belief.
            target: What is asked of the tool.
            task: A key of `DIRECTIONS`.
            errors: Of the tool, m and rad.
            box: (n,) and (n,) smallest and largest velocity that the joints can have next.
            eased: Whether the joints can do what following the error asks.
        """
        if self.has_reached(errors):
            return None
        share = LEFT_SHARE if self._out else 1.0
        left_m, left_rad = self._search(configuration, target, task)
        beyond = left_m > share * REACHED_M or left_rad > share * REACHED_RAD
        if self._out and not beyond:
            self._back_s += self._period_s
            self._out = not (eased or self._back_s >= CATCH_UP_S)
        elif beyond and self._found:
            self._out, self._back_s = True, 0.0
        if not self._out:
            return None
        return OutOfReach(self._towards(configuration, box), left_m)

    def _search(
        self, configuration: mink.Configuration, target: Target, task: str
    ) -> tuple[float, float]:
        """A few steps nearer to the nearest configuration; what is left of the error there, m and rad."""
        arm = self._arm
        qpos = np.array(configuration.q)
        if self._nearest is None:
            self._nearest, self._damping = qpos[arm.qpos], 1.0
        q = self._nearest
        error, rows, left = self._error(qpos, q, target, task)
        self._found = False
        for _ in range(STEPS):
            cost = float(error @ error)
            damping = self._damping * np.sqrt(cost) * self._length_m + 1e-8
            gradient = rows.T @ error
            # A joint at its stop that is pushed beyond it is not there to be used.
            free = ~(
                ((q <= arm.lower_rad) & (gradient < 0.0))
                | ((q >= arm.upper_rad) & (gradient > 0.0))
            )
            used = rows * free
            step = used.T @ np.linalg.solve(used @ used.T + damping * np.eye(len(error)), error)
            trial = np.clip(q + step, arm.lower_rad, arm.upper_rad)
            moved = float(np.abs(trial - q).max())
            if moved < FOUND_RAD or float(step @ gradient) < FOUND_SHARE * cost:
                self._found = True
                break
            found = self._error(qpos, trial, target, task)
            if float(found[0] @ found[0]) < cost:
                q, (error, rows, left) = trial, found
                self._damping = max(0.5 * self._damping, 0.25)
            else:
                self._damping *= 4.0
        self._nearest = q
        return left

    def _error(
        self, qpos: Array, q: Array, target: Target, task: str
    ) -> tuple[Array, Array, tuple[float, float]]:
        """Weighted error (m,) in the tool's frame, its rows (m, n), and its size in m and rad."""
        arm, trial = self._arm, self._trial
        qpos[arm.qpos] = q
        trial.update(qpos)
        data = trial.data
        here, turned = data.site_xpos[arm.tool_site], data.site_xmat[arm.tool_site].reshape(3, 3)
        base = data.xpos[trial.model.body_rootid[trial.model.site_bodyid[arm.tool_site]]]
        self._length_m = max(self._length_m, float(np.linalg.norm(here - base)), 1e-3)
        way = turned.T @ (target.position_m - here)
        now, turn, inverse = np.empty(4), np.empty(3), np.empty(4)
        mujoco.mju_mat2Quat(now, data.site_xmat[arm.tool_site])
        wanted = np.asarray(target.wxyz, dtype=float)
        if task == "axis":
            wanted = turned_towards(now, pointing(now), pointing(wanted))
        mujoco.mju_negQuat(inverse, now)
        mujoco.mju_mulQuat(inverse, inverse.copy(), wanted)
        mujoco.mju_quat2Vel(turn, inverse, 1.0)
        size = DIRECTIONS[task]
        rows = trial.get_frame_jacobian(arm.tool_site_name, "site")[:size, arm.dofs]
        error = np.concatenate([way, TURN_LENGTH_M_PER_RAD * turn])[:size]
        rows = rows * np.array([1.0, 1.0, 1.0, *(TURN_LENGTH_M_PER_RAD,) * 3])[:size, None]
        angle = float(np.linalg.norm(turn)) if size > 3 else 0.0
        return error, rows, (float(np.linalg.norm(way)), angle)

    def _towards(self, configuration: mink.Configuration, box: tuple[Array, Array]) -> Array:
        """(n,) the next velocity on the way to the nearest configuration, which ends there."""
        arm = self._arm
        assert self._nearest is not None
        way = self._nearest - configuration.q[arm.qpos]
        velocity = np.empty(len(way))
        gate_box.towards(way, self._gain_per_s, self._deceleration, self._period_s, *box, velocity)
        return velocity
