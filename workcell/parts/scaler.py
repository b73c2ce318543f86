"""A wanted joint velocity, slowed so that every time to collision is kept (docs/theory.md section 5).

In: watched pairs, the velocity that somebody's controller wants for some joints, what is known of all other joints.
Out: the same direction at a factor in [0, 1]. For an arm that must not leave its path; where slowing is not enough
(another arm comes), `ScaleBound.shortfall_m_s` says how much opening rate is missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from workcell.control.finite import at_least_zero, joint_indices, positive, vector
from workcell.control.scaling import (
    FactorChoice,
    FactorGovernor,
    ScaleBound,
    acceleration_interval,
    pairwise_factor,
)
from workcell.parts.watch import PairWatch

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Scaled:
    """A scaled velocity, and why it is not larger."""

    velocity: Array
    """(n,) what to command, 1/s times rad or m."""
    bound: ScaleBound
    """What the times to collision allow."""
    choice: FactorChoice
    """The factor that was granted, and what set it."""


class SpeedScaler:
    """Scales the velocity of some joints of a model.

    Args:
        watch: The watched pairs.
        dofs: (n,) the joints that are scaled, indices into qvel.
        t_min_s: Smallest time to collision to keep, > 0.
        period_s: Control period, > 0.
        standoff_m: Distance to which the time is counted, >= 0.
        acceleration_limit: (n,) what the joints can do, > 0; None leaves it out.
        rise_time_s: Time from standstill to full speed once nothing is near, > 0: witness points that switch make
            the bound jump, and the factor may fall at once but rises slowly.

    Raises:
        InputError: A value has another shape or is out of range.
    """

    def __init__(
        self,
        watch: PairWatch,
        dofs: Sequence[int],
        *,
        t_min_s: float,
        period_s: float,
        standoff_m: float = 0.0,
        acceleration_limit: ArrayLike | None = None,
        rise_time_s: float = 0.25,
    ):
        self.watch = watch
        self.dofs = joint_indices(dofs, watch.model.nv)
        self.t_min_s = positive("t_min_s", t_min_s)
        self.period_s = positive("period_s", period_s)
        self.standoff_m = at_least_zero("standoff_m", standoff_m)
        self._limit: Array | None = None
        if acceleration_limit is not None:
            self._limit = vector("acceleration_limit", acceleration_limit, len(self.dofs))
            for k, limit in enumerate(self._limit.tolist()):
                positive(f"acceleration_limit[{k}]", limit)
        self._governor = FactorGovernor(
            rise_per_s=1.0 / positive("rise_time_s", rise_time_s), period_s=period_s
        )
        self._last = np.zeros(len(self.dofs))

    def reset(self) -> None:
        """Start from standstill again."""
        self._governor.reset()
        self._last[:] = 0.0

    def scale(
        self, data: mujoco.MjData, wanted: ArrayLike, *, others: ArrayLike | None = None
    ) -> Scaled:
        """The velocity for this period.

        Args:
            data: At the present configuration.
            wanted: (n,) velocity of the scaled joints.
            others: (nv,) velocities of all joints, of which those of the scaled ones are not read; those of the
                data if left out. What another arm will do, as far as it is known.

        Raises:
            InputError: A value has another shape or is not finite.
        """
        velocity = vector("wanted", wanted, len(self.dofs))
        rest = np.array(
            vector("others", data.qvel if others is None else others, self.watch.model.nv)
        )
        rest[self.dofs] = 0.0
        near = self.watch.look(data)
        bound = pairwise_factor(
            near.distance_m,
            near.jacobian[:, self.dofs] @ velocity,
            near.jacobian @ rest,
            self.t_min_s,
            standoff_m=self.standoff_m,
        )
        interval = None
        if self._limit is not None:
            interval = acceleration_interval(self._last, velocity, self._limit, self.period_s)
        choice = self._governor.choose(bound.factor, interval)
        self._last = choice.factor * velocity
        return Scaled(self._last.copy(), bound, choice)
