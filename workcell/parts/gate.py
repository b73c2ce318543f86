"""The gate in front of anybody's velocity controller (docs/theory.md section 9).

In: a joint velocity of any origin, a learned policy's or a faulty one's. Out: the same velocity if the joints can
follow it, it keeps every time to collision and a stop from it is verified; else the nearest one that does, else
braking. Other joints are counted on with the velocities in the data.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from workcell.control.finite import at_least_zero, joint_indices, positive, vector
from workcell.control.gate import (
    Gated,
    GateGeometry,
    GateRules,
    JointLimits,
    JointState,
    gate,
)
from workcell.errors import InputError
from workcell.parts.watch import PairWatch

Array = NDArray[np.float64]


class CommandGate:
    """Lets commands of one arm through.

    Args:
        watch: The watched pairs; those that none of the joints moves are left alone.
        dofs: (n,) the arm's joints, hinges and slides, indices into qvel.
        speed: (n,) largest joint speeds, > 0.
        acceleration: (n,) with which the joints speed up and brake, > 0.
        rules: Period, t_min, d_min, latency, ...

    Raises:
        InputError: A value has another shape or is out of range.
    """

    def __init__(
        self,
        watch: PairWatch,
        dofs: Sequence[int],
        *,
        speed: ArrayLike,
        acceleration: ArrayLike,
        rules: GateRules,
    ):
        model = watch.model
        self.watch, self.rules = watch, rules
        self.dofs = joint_indices(dofs, model.nv)
        positive("rules.period_s", rules.period_s)
        positive("rules.t_min_s", rules.t_min_s)
        for name in ("standoff_m", "latency_s", "hold_m"):
            at_least_zero(f"rules.{name}", getattr(rules, name))
        n = len(self.dofs)
        joints = model.dof_jntid[self.dofs]
        kinds = model.jnt_type[joints]
        if not np.isin(kinds, (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)).all():
            raise InputError(
                f"dofs {self.dofs.tolist()}: allowed are joints of type hinge and slide"
            )
        self._qpos = model.jnt_qposadr[joints].astype(np.intp)
        limited = model.jnt_limited[joints].astype(bool)
        self._limits = JointLimits(
            np.where(limited, model.jnt_range[joints, 0], -np.inf),
            np.where(limited, model.jnt_range[joints, 1], np.inf),
            _positive("speed", speed, n),
            _positive("acceleration", acceleration, n),
            np.full(n, np.inf),
        )
        self._geometry = GateGeometry(model, self.dofs, watch.geom, range(len(watch)))
        self._nothing = np.zeros(n)
        self.reset()

    def reset(self, last: ArrayLike | None = None) -> None:
        """Begin anew, from standstill or from a last command (n,)."""
        n = len(self.dofs)
        self._last = np.zeros(n) if last is None else np.array(vector("last", last, n))
        self._change = np.zeros(n)

    @property
    def last(self) -> Array:
        """(n,) what was let through last."""
        return self._last.copy()

    def let_through(
        self, data: mujoco.MjData, command: ArrayLike, *, others: ArrayLike | None = None
    ) -> Gated:
        """What goes to the servos in this period.

        Args:
            data: At the measured configuration.
            command: (n,) wanted joint velocities; one that is not finite is answered by braking.
            others: (nv,) velocities of all joints, of which the arm's own are not read; those of the data if left out.

        Raises:
            InputError: A value has another shape, or a velocity of others is not finite.
        """
        wanted = np.array(command, dtype=float)
        if wanted.shape != self._last.shape:
            raise InputError(f"command has shape {wanted.shape}; allowed is {self._last.shape}")
        rest = np.array(
            vector("others", data.qvel if others is None else others, self.watch.model.nv)
        )
        rest[self.dofs] = 0.0
        near = self.watch.look(data)
        answer = gate(
            wanted,
            JointState(
                data.qpos[self._qpos].copy(), self._last, self._change, self._nothing, self._nothing
            ),
            self._limits,
            self._geometry.rows(data, near),
            self.rules,
            other_m_s=near.rate_m_s(rest)[self._geometry.pair],
        )
        self._change = (answer.command - self._last) / self.rules.period_s
        self._last = np.array(answer.command)
        return answer


def _positive(name: str, values: ArrayLike, n: int) -> Array:
    array = np.array(vector(name, values, n))
    for k, value in enumerate(array.tolist()):
        positive(f"{name}[{k}]", value)
    return array
