"""What a live run needs of the surface at which a person sits, whatever it is: a page or a window."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from workcell.live.devices import DeviceInput
from workcell.live.latency import LatencyMeter
from workcell.live.marker import Pose
from workcell.live.status import Status

READY, COUNTING, RUNNING, PAUSED = "ready", "counting", "running", "paused"
"""Phases of a run. In all but `running` time stands still."""


@dataclass(frozen=True)
class Tool:
    """One driven tool, as the controller sees it."""

    pose: Pose
    speed_m_s: float = 0.0
    short: bool = False
    """Whether it is short of its present target."""


@dataclass(frozen=True)
class Picture:
    """What is to be seen."""

    qpos: NDArray[np.float64]
    """(nq,)"""
    time_s: float
    status: Status | None = None
    """None before the first tick."""
    pace: str = "real time"
    """How fast the run goes, in words."""
    slow: bool = False
    """Whether it goes slower than the clock."""
    recording: bool = False
    """Whether a take is being recorded."""
    missed: str = ""
    """Late ticks, in words."""
    witness_m: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
    """Ends of the line drawn between the most urgent pair."""
    ahead_m: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    """(n, 3) points of the path that each support arm is about to follow."""


class Desk(Protocol):
    """A surface with markers to drag, keys to press, and something to look at. Opened as a context."""

    latency: LatencyMeter
    """Told of every input that may set an arm in motion."""
    frames: int
    """Pictures shown."""

    @property
    def is_open(self) -> bool:
        """False once the person has left."""
        ...

    @property
    def phase(self) -> str:
        """One of the phases above."""
        ...

    def begin(self, poses: dict[str, Pose]) -> None:
        """A run begins, with the tools there; the person decides when."""
        ...

    def hands(self, tools: dict[str, Tool]) -> dict[str, Pose] | None:
        """Where the person wants each driven tool; None if there is nothing new. Asked once a tick."""
        ...

    @property
    def out_of_reach(self) -> frozenset[str]:
        """Arms whose tools have stopped short of their targets."""
        ...

    def asked(self) -> DeviceInput:
        """What else was asked for since the last call."""
        ...

    def show(self, picture: Picture) -> None:
        """Set what is seen next; never waits."""
        ...

    def conclude(self, report: str) -> None:
        """The session is over; show the person how it went."""
        ...


Say = Callable[[str], None]
"""Takes lines for the person's terminal."""
