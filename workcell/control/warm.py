"""Compile every law that a tick can call, so that no tick waits for it (`workcell compile`)."""

from __future__ import annotations

import tempfile
from pathlib import Path

import mink
import numpy as np

from workcell import scenario
from workcell.control import criteria, scaling, ttc
from workcell.control.controller import Controller
from workcell.control.criteria import NullspaceObjective
from workcell.control.ik import ArmIk
from workcell.control.laws import cache_folder
from workcell.control.laws.pair_rule import smallest_rates
from workcell.control.laws.speed_scale import backing_factor
from workcell.motion.path import standing
from workcell.motion.setpoint import Setpoint
from workcell.scene import cell as scene

REACH_TICKS = 20
"""After so many ticks a target far away is known to be out of reach."""


def warm() -> Path:
    """Call every law once, as a run does.

    Returns:
        The folder with their machine code.

    Raises:
        OSError: Neither the package's own folder nor the user's cache can be written.
    """
    folder = cache_folder()
    _public_laws()
    with tempfile.TemporaryDirectory() as temporary:
        for order in (1, 2):
            # A cap that the first motion exceeds, so that its rows are called, too.
            slow = "control.point_speed_m_s=0.001"
            loaded = scenario.load("handover", (f"control.order={order}", slow))
            cell = scene.build(loaded, Path(temporary) / str(order))
            belief = mink.Configuration(cell.model)
            cell.place_home(belief.data)
            Controller(cell).step(belief.data.qpos.copy(), np.zeros(cell.model.nv))
        _rare_programs(cell, belief)
        _rare_ticks(cell, belief)
    return folder


def _public_laws() -> None:
    """What is called by users alone, or by a tick that must yield."""
    pair = np.ones(1)
    ttc.smallest(ttc.reciprocal_first_order(pair, pair))
    ttc.reciprocal_second_order(pair, pair, pair)
    criteria.artc_signed(pair, pair)
    nothing = criteria.objective("armd", pair, pair, np.ones((1, 1)))
    criteria.with_room_to_stops(nothing, pair, -pair, pair, 1.0)
    scaling.pairwise_factor(pair, pair, pair, 1.0)
    scaling.slow_near(pair, 0.0, 1.0)
    smallest_rates(pair, pair, 1.0, 0.0, np.empty(1))
    backing_factor(pair, pair)


def _rare_ticks(cell: scene.Cell, belief: mink.Configuration) -> None:
    """What a tick calls where the gate does not let a command pass, and where a target is out of reach."""
    controller, still = Controller(cell), np.zeros(cell.model.nv)
    for arm in cell.arms:
        if arm.support:
            controller.command({arm.name: 100.0 * arm.velocity_limit_rad_s})
        else:
            controller.drive(arm.name, _Away())
    for _ in range(REACH_TICKS):
        controller.step(belief.data.qpos.copy(), still)


class _Away:
    """A hand that is out of reach of any arm."""

    def setpoint(self, time_s: float) -> Setpoint:
        return Setpoint(standing(np.full(3, 100.0), np.array([1.0, 0.0, 0.0, 0.0])), "away")


def _rare_programs(cell: scene.Cell, belief: mink.Configuration) -> None:
    """What the inverse kinematics solves only where the first program does not do."""
    arm, n = cell.arms[0], len(cell.arms[0].dofs)
    ik = ArmIk(arm, nv=cell.model.nv, dt_s=1.0, task_gain_per_s=1.0, criterion_gain=1.0)
    still, rows = np.zeros(n), (np.zeros((1, n)), np.zeros(1))
    ik.followed(belief, still, still)
    ik.predicted(belief, still, still)
    ik.evade(belief, still, still, *rows)
    ik.solve(belief, still, NullspaceObjective.nothing(n), *rows)
