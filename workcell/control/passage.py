"""Gate stage: every command of a support arm passes here, whatever made it, before a servo sees it."""

from __future__ import annotations

from workcell.control.arm import ControlledArm
from workcell.control.strategy import ArmView
from workcell.control.tick import Command, Steering
from workcell.scene.cell import Cell


class Passage:
    """The way from strategies to servos. No command goes past it.

    Args:
        cell: The cell.
    """

    def __init__(self, cell: Cell):
        self._cell = cell

    def let_through(self, arm: ControlledArm, view: ArmView, steering: Steering) -> Command:
        """The command for one arm: what its strategy answered, as it is."""
        return Command(steering.velocity_rad_s)
