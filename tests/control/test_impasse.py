"""A post in the way of an arm that cannot get past: everything is tried in order, nothing is touched."""

from __future__ import annotations

from itertools import groupby

import mujoco
import numpy as np
import pytest

from tests import cells
from workcell.control.controller import Controller
from workcell.control.record import TickRecord
from workcell.control.recovery import ATTEMPT_S, ATTEMPTS, IMPASSE_S
from workcell.control.setpoints import REJOIN_M

DT = 0.02
STANDOFF_M = 0.02
"""Above d_min: the arm comes to rest before it must be halted."""


def ideal(cell, push=lambda k: None):
    """Run the controller on an ideal plant; `push(k)` may add to what the nurse's joints really do."""
    controller, data = Controller(cell), mujoco.MjData(cell.model)
    cell.place_home(data)
    for k in range(cell.scenario.ticks):
        record = controller.step(data.qpos, data.qvel)
        yield record
        data.qvel[:] = record.command_rad_s
        pushed = push(k)
        if pushed is not None:
            data.qvel[cell.arms[1].dofs] += pushed
        mujoco.mj_integratePos(cell.model, data.qpos, np.asarray(data.qvel), cell.period_s)


@pytest.fixture(scope="module")
def stuck_cell(tmp_path_factory):
    """The nurse is to move its tool to the other side of a post."""
    content = cells.duet(standoff_m=STANDOFF_M)
    content["simulation"] |= {"duration_s": 30.0, "period_s": DT}
    content["arm"][0]["base_position_m"] = [1.5, 0.0, 0.0]
    content["arm"][1]["job"] = [{"kind": "move", "waypoints": [{"position_m": [-0.09, 0.60, 0.3]}]}]
    content["obstacle"] = [
        {
            "name": "post",
            "shape": "capsule",
            "size_m": [0.03, 0.2],
            "position_m": [-0.17, 0.64, 0.3],
        }
    ]
    return cells.build(tmp_path_factory.mktemp("impasse"), content)


@pytest.fixture(scope="module")
def stuck(stuck_cell) -> list[TickRecord]:
    return list(ideal(stuck_cell))


def test_attempts_come_in_order_each_with_its_time(stuck):
    spans = [
        (a, len(list(rows)) * DT) for a, rows in groupby(r.arms["nurse"].attempt for r in stuck)
    ]
    names = [name for name, _ in spans]
    assert names == ["", *ATTEMPTS, ""]
    for _, lasted_s in spans[1:-1]:
        assert lasted_s == pytest.approx(ATTEMPT_S, abs=2 * DT)


def test_it_stood_for_the_stated_time_before_it_is_called_an_impasse(stuck):
    first = next(k for k, r in enumerate(stuck) if r.arms["nurse"].attempt)
    before = [r.arms["nurse"].scale for r in stuck[first - round(IMPASSE_S / DT) + 2 : first]]
    assert max(before) < 0.03


def test_when_everything_has_been_tried_it_holds(stuck):
    assert {r.arms["nurse"].mode for r in stuck[-50:]} == {"hold"}
    assert {r.arms["nurse"].job for r in stuck[-50:]} == {"move"}


def test_backing_off_goes_back_on_the_path_and_nothing_is_touched(stuck):
    clock = [r.arms["nurse"].path_s for r in stuck if r.arms["nurse"].attempt == "back_off"]
    assert clock[-1] < clock[0] - 0.5
    assert min(r.pair_distance_m.min() for r in stuck) > STANDOFF_M


def test_backing_off_respects_what_the_joints_can_do(stuck, stuck_cell):
    """The way back is solved for like the way there: limits of position and acceleration hold in every tick."""
    (nurse,) = (arm for arm in stuck_cell.arms if arm.name == "nurse")
    commands = np.array([r.command_rad_s[nurse.dofs] for r in stuck])
    change = np.abs(np.diff(commands, axis=0, prepend=0.0)) / DT
    assert (change <= nurse.acceleration_limit_rad_s2 * (1 + 1e-6)).all()
    q = np.array([r.qpos[nurse.qpos] for r in stuck])
    assert (q >= nurse.lower_rad - 1e-9).all()
    assert (q <= nurse.upper_rad + 1e-9).all()


def test_a_presentation_out_of_reach_is_tried_from_every_side_and_then_held(tmp_path):
    """Planar arms cannot come from above, nor turn the other ways: found by the clock that stands."""
    content = cells.duet()
    content["simulation"] |= {"duration_s": 25.0, "period_s": DT}
    content["arm"][1]["job"] = [
        {"kind": "present", "arm": "surgeon", "entry": "above", "distance_m": 0.15}
    ]
    cell = cells.build(tmp_path, content)
    records = list(ideal(cell))
    nurse = [r.arms["nurse"] for r in records]
    attempts = [a for a, _ in groupby(arm.attempt for arm in nurse)]
    assert attempts == ["", *["back_off", "re_enter", ""] * 2], "no elbow helps against that"
    goals = {tuple(np.round(arm.target_position_m, 1)) for arm in nurse}
    assert len(goals) > 3, "it went for places on more than one side"
    assert {arm.mode for arm in nurse[-100:]} == {"hold"}
    assert max(arm.tool_error_m for arm in nurse) < 0.06, "it does not thrash"
    assert min(r.pair_distance_m.min() for r in records) > cell.scenario.control.d_min_m


def test_an_arm_off_its_path_comes_back_before_the_path_goes_on(tmp_path):
    """However fast the path is: while the clock stands still, so does the target."""
    content = cells.duet()
    content["arm"][0]["base_position_m"] = [1.5, 0.0, 0.0]
    content["arm"][1]["job"] = [
        {"kind": "move", "waypoints": [{"position_m": [-0.1, 0.5, 0.3]}], "speed_m_s": 0.4}
    ]
    cell = cells.build(tmp_path, content)
    pushed = [0.8, 0.8, 0.8]
    errors, clocks = [], []
    for k, record in enumerate(ideal(cell, push=lambda k: pushed if 40 <= k < 65 else None)):
        row = record.arms["nurse"]
        errors.append(row.tool_error_m)
        clocks.append(row.path_s)
        if k >= 64 and row.tool_error_m > 1.1 * REJOIN_M:
            assert not row.target_velocity_m_s.any()
        if row.job == "done":
            break
    assert max(errors) > 2 * REJOIN_M, "it must really have been pushed off"
    held = np.flatnonzero(np.array(errors) > 1.1 * REJOIN_M)
    after = held[held > 66]
    assert np.ptp(np.array(clocks)[after]) < 1e-9, "the clock waits"
    assert (np.diff(np.array(errors)[after]) < 0.0).all(), "and the arm comes back all the while"
    assert row.job == "done"
