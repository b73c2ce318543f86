"""Did the arms touch, by the high-resolution geometry, and whose motion closed the gap?

Watches the plant's true state during a run. The distances are those of the final check's own
search (docs/final_check.md), made here once more in process and judged at contact, not at d_min:
neither the controller's capsules nor its belief enter. At a contact each arm's share of the
closing speed of the pair is taken, -∂d/∂q q̇ over its own joints, by central differences of the
distance itself, which exist on faces and edges and under penetration alike.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.control.controller import Controller
from workcell.guard.checker import Checker
from workcell.guard.settings import CheckSettings
from workcell.guard.shared_memory import CLOSED, NOBODY, Request
from workcell.scene.cell import Cell

CAUSING_M_S = 1e-3
"""An arm whose own motion closes the gap faster has a part in it. Chosen as a tenth of the slowest
closing speed that matters, d_min / t_min at their defaults, and well above the creep of a servo."""
DIFFERENCE_S = 1e-4
"""Time over which distances are differenced: a few micrometres of motion at working speeds, far above
the search's 1e-7 m and far below any feature of a housing."""
LOOK_S = 0.01
"""Time from one look to the next; where a tick is longer, every tick. The final check's own, at its default."""
FAR_M = 0.1
"""Where the last look found nothing as near as this, the next may be later ..."""
FAR_LOOK_S = 0.04
"""... by this: chosen so that nothing slower than 2.5 m/s comes through in between, five times the
fastest arm here."""
_ANY_SPEED_M_S = 1e6


@dataclass(frozen=True)
class Contact:
    """The first touch of a run."""

    time_s: float
    """When, s of simulated time."""
    pair: tuple[str, str]
    """Names of the two pieces."""
    support_m_s: float
    """How fast the support arms' own motion closed the gap, m/s; negative if it opened it."""
    priority_m_s: float
    """The same of the priority arms."""

    @property
    def cause(self) -> str:
        """`support`, `priority`, `both`, or `none` where nobody's motion closed the gap."""
        support, priority = self.support_m_s > CAUSING_M_S, self.priority_m_s > CAUSING_M_S
        if support and priority:
            return "both"
        return "support" if support else "priority" if priority else "none"


class ContactJudge:
    """Watches one run; `look` is its `watch`.

    Args:
        cell: What is simulated.
        scene_xml: Its scene file, compiled here anew.
        settings: What the run's own final check is told; the judge keeps its arms, its exempt pairs
            and the period, and d_min only for `below_d_min`.
    """

    def __init__(self, cell: Cell, scene_xml: Path, settings: CheckSettings):
        # Tools that are meant to meet may come near, not through each other, unless the exchange
        # itself declares a soft contact by a negative distance.
        terms = tuple(
            replace(e, d_min_m=min(0.0, e.d_min_m), max_closing_m_s=_ANY_SPEED_M_S)
            for e in settings.exemptions
        )
        # A hand is clear of what it let go at the check's own distance, as in the check.
        self._checker = Checker(
            scene_xml,
            replace(settings, d_min_m=0.0, clear_m=settings.d_min_m, exemptions=terms),
        )
        self._data = mujoco.MjData(self._checker.model)
        self._period_s = settings.period_s
        self._d_min_m = settings.d_min_m
        self._next_s = 0.0
        support = [bool(arm.job) for arm in cell.scenario.arm]
        self._support, self._priority = (
            np.concatenate(
                [
                    np.asarray(arm.dofs, dtype=np.intp)
                    for arm, is_support in zip(cell.arms, support, strict=True)
                    if is_support == kind
                ]
                or [np.array([], dtype=np.intp)]
            )
            for kind in (True, False)
        )
        self._opened: dict[str, int] = {}
        self.smallest_m = float("inf")
        """Smallest distance seen over all pairs that are not meeting, m."""
        self.smallest_pair: tuple[str, str] | None = None
        """Its two pieces."""
        self.smallest_support_m = float("inf")
        """Smallest distance seen that a support arm's own motion was closing, m."""
        self.contact: Contact | None = None
        """The first contact."""

    @property
    def below_d_min(self) -> bool:
        """Whether pairs that are not meeting came as near as d_min, where the final check halts the arms."""
        return self.smallest_m <= self._d_min_m

    def look(self, tick: int, data: mujoco.MjData, controller: Controller) -> None:
        """See `workcell.run.simulate`: before every tick, the true state and the open exchanges."""
        # Half a tick of slack: times are products of ticks and meet only up to rounding.
        time_s = (tick + 0.5) * self._period_s
        if time_s < self._next_s:
            return
        nearest_m = self.judge(
            tick,
            np.array(data.qpos),
            np.array(data.qvel),
            controller.windows,
            controller.grasps.holders,
        )
        self._next_s = tick * self._period_s + (FAR_LOOK_S if nearest_m > FAR_M else LOOK_S)

    def judge(
        self,
        tick: int,
        qpos: NDArray[np.float64],
        qvel: NDArray[np.float64],
        windows: list[str],
        holders: dict[str, str | None] | None = None,
    ) -> float:
        """Take one configuration into account; returns the smallest distance in it, m, of what is meeting too.

        Args:
            tick: When.
            qpos: (nq,) true positions.
            qvel: (nv,) true velocities.
            windows: Names of the exemptions that are open.
            holders: For every instrument the arm that holds it; left out where there is none.
        """
        settings = self._checker.settings
        held_by = [(holders or {}).get(item.name) for item in settings.instruments]
        self._opened = {name: self._opened.get(name, tick) for name in windows}
        answer = self._checker.answer(
            Request(
                sequence=tick + 1,
                tick=tick,
                opened_ticks=tuple(self._opened.get(e.name, CLOSED) for e in settings.exemptions),
                qpos=qpos,
                holders=tuple(
                    NOBODY if arm is None else settings.arm_index(arm) for arm in held_by
                ),
            )
        )
        nearest_m = min(answer.distance_m, answer.exempt_distance_m)
        fault = answer.exemption_fault >= 0
        pair = answer.exempt_pair if fault and answer.distance_m > 0.0 else answer.pair
        if pair[0] < 0:
            return nearest_m
        if answer.distance_m < self.smallest_m:
            self.smallest_m, self.smallest_pair = answer.distance_m, self._names(answer.pair)
        touches = answer.halt and self.contact is None
        if not (touches or answer.distance_m < self.smallest_support_m):
            return nearest_m
        support_m_s = self.closing_m_s(pair, qpos, qvel, self._support)
        if support_m_s > CAUSING_M_S:
            self.smallest_support_m = min(self.smallest_support_m, answer.distance_m)
        if touches:
            priority_m_s = self.closing_m_s(pair, qpos, qvel, self._priority)
            self.contact = Contact(
                tick * self._period_s, self._names(pair), support_m_s, priority_m_s
            )
        return nearest_m

    def closing_m_s(
        self,
        pair: tuple[int, int],
        qpos: NDArray[np.float64],
        qvel: NDArray[np.float64],
        dofs: NDArray[np.intp],
    ) -> float:
        """How fast the motion of some joints alone closes a pair of pieces, m/s."""
        own = np.zeros(self._checker.model.nv)
        own[dofs] = qvel[dofs]
        ahead, behind = (
            self._distance_m(pair, qpos, own, dt) for dt in (DIFFERENCE_S, -DIFFERENCE_S)
        )
        return (behind - ahead) / (2.0 * DIFFERENCE_S)

    def _distance_m(
        self,
        pair: tuple[int, int],
        qpos: NDArray[np.float64],
        qvel: NDArray[np.float64],
        dt_s: float,
    ) -> float:
        model, data = self._checker.model, self._data
        moved = qpos.copy()
        mujoco.mj_integratePos(model, moved, qvel, dt_s)
        data.qpos[:] = moved
        mujoco.mj_kinematics(model, data)
        i, j = (self._checker.geometry.pieces[k].geom for k in pair)
        ceiling = self._checker.settings.ceiling_m + 1.0
        return float(mujoco.mj_geomDistance(model, data, i, j, ceiling, None))

    def _names(self, pair: tuple[int, int]) -> tuple[str, str]:
        i, j = (self._checker.geometry.pieces[k].name for k in pair)
        return i, j
