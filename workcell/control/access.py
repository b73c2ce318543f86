"""What may be asked of a controller and told to it between two ticks: commands, operators, settings, records."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workcell.control import pair_assignment
from workcell.control.arm import ControlledArm
from workcell.control.commanded import Twist, checked
from workcell.control.record import TickRecord
from workcell.control.sensing import Sensing
from workcell.control.steering import Strategies
from workcell.errors import InputError, did_you_mean
from workcell.motion.jobs import JobSequence
from workcell.motion.setpoint import Operator
from workcell.scenario import Control
from workcell.scene.cell import Cell


class ControllerAccess:
    """A controller as others see it; its ticks are in `controller.py`.

    Args:
        cell: The compiled cell; the controller makes its own data and never touches the plant's.
    """

    def __init__(self, cell: Cell):
        self.cell = cell
        self.tick = 0
        self._settings: Control = cell.scenario.control
        self._sensing = Sensing(cell)
        self.grasps = self._sensing.grasps
        belief = self._sensing.belief
        self._arms = [ControlledArm(cell, arm, belief) for arm in cell.arms]
        support = [arm for arm in self._arms if arm.support]
        self._support = sorted(support, key=lambda arm: arm.addresses.priority)
        self._strategies = Strategies(cell)
        pair_assignment.assign(cell, self.grasps, self._sensing.watched, self._arms)
        self._commands: dict[str, NDArray[np.float64] | Twist] = {}
        """What is asked from outside, for the next tick."""
        self._record: TickRecord | None = None

    @property
    def operators(self) -> dict[str, Operator]:
        """The operators by the name of their arm."""
        return {arm.name: arm.operator for arm in self._arms if arm.operator is not None}

    @property
    def jobs(self) -> dict[str, JobSequence]:
        """The job sequences by the name of their arm, to be looked at only."""
        return {arm.name: arm.jobs for arm in self._arms if arm.jobs is not None}

    def drive(self, arm: str, operator: Operator) -> None:
        """Put another operator in the place of an arm's own: a replay does so for one who was live."""
        next(a for a in self._arms if a.name == arm).operator = operator

    def command(self, wanted: Mapping[str, ArrayLike | Twist]) -> None:
        """Ask arms for joint velocities (n,) or tool twists in the next tick, in the place of their strategies.

        Args:
            wanted: By the arms' names; it takes the place of what was asked before.

        Raises:
            InputError: there is no such arm, or a command has another shape or a number that is not finite.
        """
        joints = {arm.name: len(arm.dofs) for arm in self._arms}
        unknown = [
            f"arm {arm!r}: unknown{did_you_mean(arm, joints)}; allowed: {', '.join(joints)}"
            for arm in wanted
            if arm not in joints
        ]
        if unknown:
            raise InputError(unknown)
        self._commands = {arm: checked(arm, joints[arm], each) for arm, each in wanted.items()}

    @property
    def settings(self) -> Control:
        """The parameters in force."""
        return self._settings

    def tune(self, **settings: Any) -> None:
        """Change parameters of `[control]` from the next tick on; what may change is `scenario.Change`."""
        self._settings = self._settings.model_copy(update=settings)

    @property
    def record(self) -> TickRecord:
        """The record of the last tick."""
        if self._record is None:
            raise RuntimeError("the controller has not ticked yet")
        return self._record

    @property
    def windows(self) -> list[str]:
        """Names of the final check's exemptions that the present jobs hold open."""
        return [arm.window for arm in self._support if arm.window is not None]

    def pairs_to_keep_apart(self, arm: str) -> NDArray[np.intp]:
        """Numbers of the watched pairs that an arm's motion changes, without those that are to meet or are in a hand.

        Raises:
            KeyError: there is no such arm.
        """
        own = {each.name: each for each in self._arms}[arm]
        moved, inactive = own.constraints.pairs.moved, self._sensing.watched.inactive
        return moved[~inactive[moved] & ~np.isin(moved, own.meeting_pairs)]

    @property
    def holders(self) -> dict[str, str | None]:
        """For every instrument the arm that is to hold it; another dict after every change."""
        return self.grasps.holders

    @property
    def faults(self) -> list[str]:
        """What is wrong with strategies that have lost their turn; empty while all of them work."""
        return self._strategies.faults
