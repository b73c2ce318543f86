"""When slowing down is not enough: a planar arm in the way of a carriage that nobody slows.

The surgeon is a carriage that comes along its rail at 0.25 m/s to where the nurse's arm is.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import mujoco
import numpy as np
import pytest

from tests import cells
from workcell.control.controller import Controller
from workcell.control.record import TickRecord
from workcell.scene import cell as scene

D_MIN_M, SPEED_M_S, T_MIN_S = 0.01, 0.25, 1.0
WAIT = {"kind": "wait", "duration_s": 60.0}
INTO_THE_WAY = {
    "kind": "move", "waypoints": [{"position_m": [-0.05, 0.72, 0.3]}], "speed_m_s": 0.3,
}  # fmt: skip
POST = {
    "name": "post", "shape": "capsule", "size_m": [0.03, 0.1], "position_m": [-0.36, 0.88, 0.3],
}  # fmt: skip


def sweep(
    *, jobs=(WAIT,), home=(0.9, 0.6, -0.4), start_s=0.2, to_x_m=-0.33, duration_s=2.6, **control
) -> dict[str, Any]:
    content = cells.duet(**control)
    content["simulation"] = {"plant": "kinematic", "duration_s": duration_s, "period_s": 0.01}
    surgeon, nurse = content["arm"]
    surgeon |= {
        "model": "slider",
        "base_position_m": [0.05, 1.0, -0.06],
        "base_wxyz": [0.0, 0.0, 0.0, 1.0],
        "home_rad": [-0.2],
        "operator": {
            "kind": "waypoints", "speed_m_s": SPEED_M_S, "acceleration_m_s2": 1.2,
            "start_s": start_s, "waypoints": [{"position_m": [to_x_m, 0.76, 0.3]}],
        },
    }  # fmt: skip
    nurse |= {"home_rad": list(home), "job": list(jobs)}
    return content


def play(folder, content, until=lambda record: False) -> tuple[scene.Cell, list[TickRecord]]:
    cell = cells.build(folder, content)
    controller, data = Controller(cell), mujoco.MjData(cell.model)
    cell.place_home(data)
    records = []
    for _ in range(cell.scenario.ticks):
        records.append(controller.step(data.qpos, data.qvel))
        data.qvel[:] = records[-1].command_rad_s
        mujoco.mj_integratePos(cell.model, data.qpos, np.asarray(data.qvel), cell.period_s)
        if until(records[-1]):
            break
    return cell, records


def smallest(cell, records, *names: str) -> float:
    """Smallest distance over the pairs whose geoms begin so."""
    pairs = [
        k
        for k, pair in enumerate(cell.pairs.names)
        if all(any(geom.startswith(name) for geom in pair) for name in names)
    ]
    return min(float(record.pair_distance_m[pairs].min()) for record in records)


@pytest.fixture(scope="module")
def given_way(tmp_path_factory):
    return play(tmp_path_factory.mktemp("yields"), sweep())


def test_a_waiting_arm_keeps_out_of_the_way_of_one_that_comes(given_way, tmp_path):
    assert smallest(*given_way, "surgeon", "nurse") > D_MIN_M
    cell, records = play(tmp_path, sweep(yields=False))
    assert smallest(cell, records, "surgeon", "nurse") < 0.0, "one that only slows down is hit"
    assert {record.arms["nurse"].mode for record in records} <= {"run", "hold"}


def test_it_says_who_is_the_cause_and_that_it_yields(given_way):
    _, records = given_way
    yielding = [record for record in records if record.arms["nurse"].mode == "yield"]
    assert len(yielding) > 100
    assert {record.mode for record in yielding} == {"yield"}
    assert {record.arms["nurse"].reason for record in yielding} == {"other_arm"}
    causes = [r.closing_cause for r in records if r.arms["surgeon"].tool_speed_m_s > 0.2]
    assert len(causes) > 100
    assert causes.count("surgeon") > 0.95 * len(causes)


def test_it_does_not_come_and_go(given_way):
    _, records = given_way
    modes = [record.arms["nurse"].mode for record in records]
    changes = sum(a != b for a, b in pairwise(modes))
    assert changes <= 3, "run, hold, yield, and once back at most"


def test_the_priority_arm_is_not_disturbed(given_way):
    _, records = given_way
    surgeon = np.array([record.arms["surgeon"].tool_error_m for record in records])
    assert surgeon.max() < 0.005
    speed = np.array([record.arms["surgeon"].tool_speed_m_s for record in records])
    assert speed.max() == pytest.approx(SPEED_M_S, rel=0.05)


def test_commands_of_a_yielding_arm_keep_speed_and_acceleration(given_way):
    cell, records = given_way
    nurse = cell.arms[1]
    commands = np.array([record.command_rad_s[nurse.dofs] for record in records])
    assert (np.abs(commands) <= nurse.velocity_limit_rad_s + 1e-9).all()
    change = np.abs(np.diff(commands, axis=0)) / cell.period_s
    assert (change <= nurse.acceleration_limit_rad_s2 * (1 + 1e-6) + 1e-6).all()


def test_it_backs_along_its_path_where_that_is_enough(tmp_path):
    """The nurse moves into the way: at first it comes back on the way it came, its clock running backwards."""
    _, records = play(
        tmp_path,
        sweep(jobs=(INTO_THE_WAY, WAIT), home=(1.5, 0.3, -0.2), start_s=1.0, duration_s=4.0),
        until=lambda record: record.arms["nurse"].scale < -0.5,
    )
    backing = [r for r in records if r.arms["nurse"].mode == "yield" and r.arms["nurse"].scale < 0]
    first = records.index(backing[0])
    came = np.array([record.arms["nurse"].tool_position_m for record in records[:first]])
    for record in backing:
        off = np.linalg.norm(came - record.arms["nurse"].tool_position_m, axis=1).min()
        assert off < 5e-3
    clock = [record.arms["nurse"].path_s for record in backing]
    assert len(clock) > 3
    assert clock[-1] < clock[0]


def test_it_does_not_give_way_into_something_else(tmp_path):
    """A post stands where the nurse would go: it goes as near as the time to collision lets it."""
    cell, records = play(tmp_path, sweep(to_x_m=-0.16) | {"obstacle": [POST]})
    assert smallest(cell, records, "nurse", "post") > D_MIN_M
    assert smallest(cell, records, "surgeon", "nurse") > D_MIN_M
    (pair,) = [
        k for k, names in enumerate(cell.pairs.names) if names == ("nurse/link3_capsule", "post")
    ]
    towards = 0
    for before, after in pairwise(records):
        gap = before.pair_distance_m[pair] - D_MIN_M
        rate = (after.pair_distance_m[pair] - before.pair_distance_m[pair]) / cell.period_s
        assert rate >= -gap / T_MIN_S - 2e-3
        towards += int(rate < -0.01)
    assert towards > 20, "it must have been pushed towards the post to mean anything"


def test_what_stands_is_not_closed_on_to_open_what_is_pressed(tmp_path):
    """A carriage between one that comes and a box: it gives way as far as the box lets it, and no faster."""
    content = sweep(duration_s=1.6)
    content["arm"][1] |= {
        "model": "slider",
        "base_position_m": [-0.2, 0.52, -0.06],
        "home_rad": [0.15],
    }
    content["obstacle"] = [
        {
            "name": "box",
            "shape": "box",
            "size_m": [0.03, 0.05, 0.05],
            "position_m": [-0.22, 0.6, 0.3],
        }
    ]
    cell, records = play(tmp_path, content)
    boxed = [
        k for k, names in enumerate(cell.pairs.names) if names == ("nurse/carriage_capsule", "box")
    ]
    assert boxed
    dofs = next(arm.dofs for arm in cell.arms if arm.name == "nurse")
    fled = 0
    for before, after in pairwise(records):
        for pair in boxed:
            distance = before.pair_distance_m[pair]
            rate = (after.pair_distance_m[pair] - distance) / cell.period_s
            assert rate >= -distance / (0.99 * T_MIN_S)
        fled += int(before.arms["nurse"].mode == "yield" and before.command_rad_s[dofs][0] < -0.02)
    assert fled > 10, "it must have given way towards the box to mean anything"


def test_nobody_gives_way_for_what_its_own_base_comes_near_to(tmp_path):
    """The surgeon sweeps by the nurse's base: the nurse can do nothing about it and works on."""
    content = sweep(jobs=(INTO_THE_WAY, WAIT), home=(1.5, 0.3, -0.2), yields=True, duration_s=1.5)
    cell = cells.build(tmp_path, content)
    controller = Controller(cell)
    constraints, settings = controller._arms[1].constraints, cell.scenario.control
    owned, standing = constraints.pairs.owned, constraints.pairs.fixed_base
    names = [cell.pairs.names[k] for k in owned[standing]]
    assert ("surgeon/carriage_capsule", "nurse/base_capsule") in names
    data = mujoco.MjData(cell.model)
    cell.place_home(data)
    controller._sensing.measure(0, data.qpos.copy(), data.qvel.copy(), data.qvel.copy(), settings)
    still = np.zeros(len(constraints.arm.dofs))
    constraints.other_m_s[owned[standing]] = -10.0
    allowance = constraints.allow(still, still, cell.period_s, settings)
    assert allowance.bound.shortfall_m_s > 1.0, "it is still told, as the other arm's"
    assert not allowance.must_yield
    constraints.other_m_s[owned[~standing]] = -10.0
    assert constraints.allow(still, still, cell.period_s, settings).must_yield


def test_of_two_support_arms_the_one_that_comes_answers_near_a_base(tmp_path):
    content = cells.duet()
    content["arm"].append(
        content["arm"][1]
        | {"name": "assistant", "base_position_m": [0.0, -0.9, 0.0], "priority": 2}
    )
    cell = cells.build(tmp_path, content)
    arms = {arm.name: arm for arm in Controller(cell)._arms}
    owned = {
        name: {cell.pairs.names[k] for k in arm.constraints.pairs.owned}
        for name, arm in arms.items()
    }
    assert ("nurse/link3_capsule", "assistant/base_capsule") in owned["nurse"]
    assert ("nurse/base_capsule", "assistant/link3_capsule") in owned["assistant"]
    assert ("nurse/link3_capsule", "assistant/link3_capsule") in owned["assistant"]
    counted = [pair for pairs in owned.values() for pair in pairs]
    assert len(counted) == len(set(counted)), "exactly one answers"
