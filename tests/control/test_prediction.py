"""What others are predicted to do is what their joints can do."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from tests import cells
from workcell.control import prediction
from workcell.control.controller import Controller
from workcell.control.laws import pair_rule
from workcell.motion.path import Target
from workcell.motion.setpoint import Setpoint


class Leaping:
    """A hand that is at once far beyond reach, and as fast as it likes."""

    def __init__(self, place_m, velocity_m_s):
        self._target = Target(
            np.array(place_m), np.array([1.0, 0, 0, 0]), np.array(velocity_m_s), np.zeros(3)
        )

    def setpoint(self, time_s: float) -> Setpoint:
        return Setpoint(self._target, "leap")


@pytest.mark.parametrize("place", [(0.0, 3.0, 0.3), (0.4, 0.5, 0.3), (-2.0, 0.0, 0.3)])
@pytest.mark.parametrize("velocity", [(0.0, 2.0, 0.0), (-3.0, 0.0, 0.0)])
def test_no_hypothesis_asks_more_than_joints_can_do(tmp_path, monkeypatch, place, velocity):
    cell = cells.build(tmp_path, cells.duet())
    controller, data = Controller(cell), mujoco.MjData(cell.model)
    cell.place_home(data)
    controller.drive("surgeon", Leaping(place, velocity))
    surgeon = next(arm for arm in cell.arms if arm.name == "surgeon")
    seen, predict = [], prediction.predict

    def watched(pairs, arm, setpoint):
        predict(pairs, arm, setpoint)
        if arm.name == "surgeon":
            seen.append(pairs.hypotheses_rad_s[:, arm.dofs].copy())

    monkeypatch.setattr(prediction, "predict", watched)
    last = np.zeros(3)
    for _ in range(80):
        record = controller.step(data.qpos, data.qvel)
        step = surgeon.acceleration_limit_rad_s2 * cell.period_s
        assert (np.abs(seen[-1] - last) <= step + 1e-6).all()
        assert (np.abs(seen[-1]) <= surgeon.velocity_limit_rad_s + 1e-9).all()
        last = record.command_rad_s[surgeon.dofs]
        # What it does is between what was counted on, but for its self-motion.
        assert (np.abs(seen[-1][2] - last) <= 2.0 * step).all()
        data.qvel[:] = record.command_rad_s
        mujoco.mj_integratePos(cell.model, data.qpos, np.asarray(data.qvel), cell.period_s)


def test_room_that_may_be_taken_back_within_the_tick_is_not_counted_on():
    """One joint of another arm opens a pair at 0.1 m/s as predicted; as last commanded 0.12, by 0.05 more or less."""
    jacobian, other = np.array([[0.5], [-0.5]]), np.empty(2)
    predicted, all_pairs, joint = np.array([[0.2], [0.24], [0.2]]), np.arange(2), np.array([0])

    def counted(change_rad_s):
        bad = pair_rule.predicted_rates(
            jacobian, all_pairs, joint, predicted, np.array([change_rad_s]), other
        )
        assert bad == -1
        return other.tolist()

    assert counted(0.0) == pytest.approx(
        [0.1, -0.12]
    )  # as it is known: the least of what is predicted
    assert counted(0.1) == pytest.approx([0.07, -0.12])
    assert counted(1.0) == pytest.approx([0.0, -0.12])  # no more than standing is taken for granted


def test_an_arm_that_has_its_command_takes_nothing_back(tmp_path):
    cell = cells.build(tmp_path, cells.duet())
    controller = Controller(cell)
    watched, nurse = controller._sensing.watched, controller._arms[1]
    prediction.predict(watched, nurse, None)  # a support arm's setpoint is not asked for
    np.testing.assert_allclose(
        watched.change_rad_s[nurse.dofs], cell.period_s * nurse.addresses.acceleration_limit_rad_s2
    )
    prediction.settle(watched, nurse, np.zeros(3))
    assert not watched.change_rad_s.any()
