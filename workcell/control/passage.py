"""Gate stage: every command of a support arm passes here, whatever made it, before a servo sees it.

What the gate itself holds is `gate/`; here it is given one arm's state, pairs and rules, and its answer becomes
the command. What an operator asks of a priority arm goes through as it is. Without the gate
(`[control] gate = false`) all commands do.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from workcell.control import gate
from workcell.control.arm import ControlledArm
from workcell.control.commanded import REASON as COMMANDED
from workcell.control.laws import flight
from workcell.control.sensing import Sensing
from workcell.control.servo import LARGEST_LAG_RAD
from workcell.control.strategy import ArmView
from workcell.control.tick import Command, Steering
from workcell.scenario import Control
from workcell.scene.cell import Cell

Array = NDArray[np.float64]

NOISE_DEVIATIONS = 4.0
"""So many standard deviations of the encoders' noise a measured position may be off: chosen to be exceeded
once in 16,000 samples."""
SERVO_S = 0.1
"""A command that is older than this has been followed: a few times the settling time of a
servo that tracks at all."""


class Passage:
    """The way from strategies to servos. No command goes past it.

    Args:
        cell: The cell.
        sensing: The belief, the pairs as measured in this tick, and who holds what.
    """

    def __init__(self, cell: Cell, sensing: Sensing):
        self._cell, self._sensing = cell, sensing
        self._gates: dict[str, _ArmGate] = {}

    def let_through(self, arm: ControlledArm, view: ArmView, steering: Steering) -> Command:
        """The command for one arm."""
        # What is asked from outside passes the gate whatever the arm's role: nobody's hand stands behind it.
        gated = arm.support or steering.reason == COMMANDED
        if not (gated and self._cell.scenario.control.gate):
            return Command(steering.velocity_rad_s)
        own = self._gates.get(arm.name)
        if own is None:
            own = self._gates[arm.name] = _ArmGate(self._cell, arm, self._sensing)
        return own.answer(view, steering.velocity_rad_s)


class _ArmGate:
    """What the gate needs of one support arm."""

    def __init__(self, cell: Cell, arm: ControlledArm, sensing: Sensing):
        addresses = arm.addresses
        n = len(addresses.dofs)
        self._cell, self._arm, self._sensing = cell, arm, sensing
        self._limits = gate.JointLimits(
            addresses.lower_rad,
            addresses.upper_rad,
            addresses.velocity_limit_rad_s,
            addresses.acceleration_limit_rad_s2,
            np.full(n, np.inf),
        )
        self._holders: Mapping[str, str | None] | None = None
        self._gate: gate.ArmGate
        self._meeting_pairs: NDArray[np.intp] | None = None
        self._last_change = np.zeros(n)
        self._flight = _Flight(cell, arm)
        self._rules: gate.GateRules | None = None
        self._settings: Control | None = None

    def answer(self, view: ArmView, velocity_rad_s: Array) -> Command:
        """What passes of a velocity (n,)."""
        arm, sensing = self._arm, self._sensing
        if sensing.grasps.holders is not self._holders:
            self._holders = sensing.grasps.holders
            self._resolve()
        if arm.meeting_pairs is not self._meeting_pairs:
            self._meeting_pairs = arm.meeting_pairs
            self._gate.meeting[...] = np.isin(self._gate.pair, arm.meeting_pairs)
        last, q = view.command_rad_s, view.q_rad
        low, high = self._flight.ahead(q, last)
        found = self._gate.answer(
            velocity_rad_s,
            gate.JointState(q, last, self._last_change, low, high),
            self._rules_of(view.settings),
            view.other_m_s,
            sensing.belief.data,
            sensing.proximity,
        )
        self._last_change = (found.command - last) / self._cell.period_s
        if not found.replaced:
            return Command(found.command)
        return Command(found.command, f"{found.how}: {', '.join(found.reasons)}", found.pair)

    def _resolve(self) -> None:
        """Anew after every change of hands: which pairs are the arm's, which geoms move with it."""
        cell, arm, pairs = self._cell, self._arm, self._arm.constraints.pairs
        tool = int(cell.model.site_bodyid[arm.addresses.tool_site])
        held = {
            item.geom: tool
            for item in cell.instruments
            if self._sensing.grasps.holder(item.name) == arm.name
        }
        geometry = gate.GateGeometry(cell.model, arm.dofs, cell.pairs.geoms, pairs.moved, held=held)
        # Of a pair that another support arm answers for, this arm counts its own motion alone.
        answers_for = np.isin(geometry.pair, pairs.owned)
        self._gate, self._meeting_pairs = gate.ArmGate(geometry, self._limits, answers_for), None

    def _rules_of(self, settings: Control) -> gate.GateRules:
        if settings is not self._settings or self._rules is None:
            self._settings = settings
            self._rules = gate.GateRules(
                period_s=self._cell.period_s,
                t_min_s=settings.t_min_s,
                d_min_m=settings.d_min_m,
                standoff_m=settings.standoff_m,
                point_speed_m_s=settings.point_speed_m_s,
            )
        return self._rules


class _Flight:
    """What joints have ahead of them before the next command acts: servo lag. (What is late, `delay.py` carries on.)

    Args:
        cell: The cell.
        arm: Its arm.
    """

    def __init__(self, cell: Cell, arm: ControlledArm):
        simulation, self._period_s = cell.scenario.simulation, cell.period_s
        n = len(arm.dofs)
        self._lately = np.zeros((max(1, round(SERVO_S / cell.period_s)), n))
        self._place, self._begins = 0, True
        # The integral of a velocity servo's commands drifts away from its joint.
        drifts = [servo.kind != "position" for servo in arm.addresses.servos] or [False] * n
        self._drifts = np.array(drifts) & (simulation.plant == "dynamic")
        self._uncertainty = NOISE_DEVIATIONS * simulation.position_noise_rad
        self._total, self._reference, self._low, self._high = np.zeros((4, n))
        self._q, self._last = np.zeros((2, n))

    def ahead(self, q_rad: Array, last_rad_s: Array) -> tuple[Array, Array]:
        """(n,) smallest and largest displacement from the present position (n,), after the last command (n,); kept arrays."""
        self._q[...], self._last[...] = q_rad, last_rad_s
        flight.ahead(
            self._q, self._last, self._period_s, self._lately, self._place, self._begins, self._drifts,
            LARGEST_LAG_RAD, self._uncertainty, self._total, self._reference,
            self._low, self._high,
        )  # fmt: skip
        self._place, self._begins = (self._place + 1) % len(self._lately), False
        return self._low, self._high
