"""What a robot has to answer, so that the controller can stand in front of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Reading:
    """What a robot says of its joints; n of them, in the order of the arm file."""

    position_rad: Array
    """(n,) rad, or m of a slide."""
    velocity_rad_s: Array
    """(n,)"""
    acted_on: int
    """Number of the command that it acts on; -1 before the first. It dates the reading: the robot had this command."""
    stopped: str = ""
    """Why it stands by its own decision (watchdog, protective stop, told to); empty if it does not."""


class RobotAdapter(Protocol):
    """One robot. No call may wait: the loop has other robots to serve."""

    def read(self) -> Reading | None:
        """The newest reading since the last call; None if nothing has come."""
        ...

    def write(self, number: int, velocity_rad_s: Array) -> None:
        """Command joint velocities.

        The robot holds them for its own watchdog's time at most, then brakes: this is what stops it when
        the loop dies, so that an adapter for a robot without one must not be written.

        Args:
            number: Of the command, rising.
            velocity_rad_s: (n,)
        """
        ...

    def stop(self, reason: str) -> None:
        """Brake as hard as the robot may, and stay. Called in every tick until the robot says that it stands."""
        ...

    def close(self) -> None:
        """Let go of the robot."""
        ...
