"""The final check as the controller sees it: ask once a tick, stay halted once told to stop.

Joins the checker process, the latch and the windows in which jobs let two tools meet. The
controller hands over joint positions and learns only whether its support arms may go on.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import asdict
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from workcell.guard.halt import HaltLatch, HaltReport
from workcell.guard.monitor import FinalCheck
from workcell.guard.verdict import Verdict


class Supervisor(Protocol):
    """What the controller needs of a final check; replays and tests bring their own."""

    def ask(
        self,
        tick: int,
        qpos: NDArray[np.float64],
        windows: Collection[str],
        holders: Mapping[str, str | None],
    ) -> Verdict:
        """The verdict for this tick.

        Args:
            tick: Control tick.
            qpos: (nq,) measured configuration.
            windows: Exemptions that jobs hold open now.
            holders: For every instrument the arm that holds it, None where it lies.
        """
        ...

    @property
    def halted(self) -> bool:
        """Whether the support arms have been told to stop."""
        ...

    def observe(
        self, tick: int, arm: str, tool_speed_m_s: float, qvel_rad_s: NDArray[np.float64]
    ) -> None:
        """Take note of how an arm comes to rest."""
        ...


class LatchedCheck:
    """A running `FinalCheck` with a latch that only `reset` releases.

    Args:
        check: A started check.
        period_s: Control period.
        live: Whether time goes on while the checker works. If not, the run waits for its answer,
            so that traces are reproducible.
    """

    def __init__(self, check: FinalCheck, *, period_s: float, live: bool = False):
        self._check = check
        self._latch = HaltLatch(period_s)
        self._period_s = period_s
        self.is_live = live
        """Whether nobody waits for the checker."""
        self._open: set[str] = set()

    @property
    def pid(self) -> int | None:
        """Process id of the checker; None while there is none."""
        return self._check.pid

    @property
    def halted(self) -> bool:
        """Whether a verdict has called for a stop since the last reset."""
        return self._latch.latched

    def reset(self) -> None:
        """Let the support arms go on; the next verdict may stop them again."""
        self._latch.reset()

    def report(self) -> HaltReport | None:
        """How the stop went; None if there was none."""
        return self._latch.report()

    def account(self) -> dict[str, Any]:
        """What goes into the summary: size, latencies of this machine, and the halt if there was one."""
        halt, latency = self.report(), self._check.latency
        handover_s = latency.handover.median_s
        return {
            "pieces": len(self._check.pieces),
            "pairs": self._check.pair_count,
            "latency": asdict(latency),
            "handover_share_of_tick": None if handover_s is None else handover_s / self._period_s,
            "halt": None if halt is None else asdict(halt),
        }

    def ask(
        self,
        tick: int,
        qpos: NDArray[np.float64],
        windows: Collection[str],
        holders: Mapping[str, str | None],
    ) -> Verdict:
        """See `Supervisor`."""
        for instrument, arm in holders.items():
            self._check.set_holder(instrument, arm)
        for name in sorted(set(windows) - self._open):
            self._check.open_exemption(name, tick)
        for name in sorted(self._open - set(windows)):
            self._check.close_exemption(name)
        self._open = set(windows)
        verdict = self._check.look(tick, qpos) if self.is_live else self._check.check(tick, qpos)
        self._latch.trip(verdict, tick)
        return verdict

    def observe(
        self, tick: int, arm: str, tool_speed_m_s: float, qvel_rad_s: NDArray[np.float64]
    ) -> None:
        """See `Supervisor`."""
        self._latch.observe(tick, arm, tool_speed_m_s, qvel_rad_s)
