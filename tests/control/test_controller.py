"""The controller as a whole: what goes in, what may come out, and that it steers nothing else."""

from __future__ import annotations

from itertools import groupby

import mujoco
import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from tests import cells
from workcell.control.controller import Controller
from workcell.control.record import TickRecord
from workcell.errors import ControlFault
from workcell.scene import cell as scene


@pytest.fixture(scope="module")
def cell(tmp_path_factory) -> scene.Cell:
    return cells.build(tmp_path_factory.mktemp("duet"), cells.duet())


def home(cell: scene.Cell) -> mujoco.MjData:
    data = mujoco.MjData(cell.model)
    cell.place_home(data)
    return data


def play(cell: scene.Cell, ticks: int, surgeon=None):
    """Run the controller on an ideal plant; `surgeon(k)` overrides what the first arm really does."""
    controller, data = Controller(cell), home(cell)
    for k in range(ticks):
        record = controller.step(data.qpos, data.qvel)
        data.qvel[:] = record.command_rad_s
        if surgeon is not None:
            data.qvel[cell.arms[0].dofs] = surgeon(k)
        mujoco.mj_integratePos(cell.model, data.qpos, np.asarray(data.qvel), cell.period_s)
        yield record


@pytest.fixture(scope="module")
def exchange(cell) -> list[TickRecord]:
    """The whole exchange on an ideal plant, until the nurse is back."""
    records = []
    for record in play(cell, cell.scenario.ticks):
        records.append(record)
        if record.arms["nurse"].job == "done":
            break
    return records


# ---------------------------------------------------------------- a tick is data


def test_the_belief_is_not_the_plant(cell):
    """Only the measured state comes in: neither plant data nor model are touched by a tick."""
    data = home(cell)
    mujoco.mj_forward(cell.model, data)
    before = (data.qpos.copy(), data.qvel.copy(), data.ctrl.copy(), data.xpos.copy(), data.time)
    Controller(cell).step(data.qpos, data.qvel)
    after = (data.qpos, data.qvel, data.ctrl, data.xpos, data.time)
    for a, b in zip(before, after, strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_tick_depends_on_nothing_but_its_inputs_and_own_memory(cell):
    """Two controllers fed the same states agree to the last bit, whatever runs in between."""
    first = list(play(cell, 60))
    again = Controller(cell)
    for record in first:
        other = again.step(record.qpos, record.qvel)
        np.testing.assert_array_equal(other.command_rad_s, record.command_rad_s)
        Controller(cell).step(record.qpos, record.qvel)


# ---------------------------------------------------------------- faults


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("where", ["qpos", "qvel"])
def test_a_state_that_is_not_finite_is_a_fault_with_tick_and_origin(cell, where, value):
    controller, data = Controller(cell), home(cell)
    for _ in range(3):
        controller.step(data.qpos, data.qvel)
    last = controller.record
    getattr(data, where)[1] = value
    with pytest.raises(ControlFault, match=f"tick 3: {where}, the measured joint") as fault:
        controller.step(data.qpos, data.qvel)
    assert fault.value.tick == 3
    assert controller.record is last, "what was decided before stays readable"


def test_a_target_that_is_not_finite_is_a_fault_that_names_arm_and_driver(cell, monkeypatch):
    controller, data = Controller(cell), home(cell)
    controller.step(data.qpos, data.qvel)
    monkeypatch.setattr(
        "workcell.motion.path.PathGeometry.pose",
        lambda self, s: (np.full(3, np.nan), np.array([1.0, 0, 0, 0])),
    )
    with pytest.raises(ControlFault, match="tick 1: the tool target of arm nurse from meet"):
        controller.step(data.qpos, data.qvel)


# ---------------------------------------------------------------- promises


def commanded_ttc(record) -> float:
    return np.inf if record.ttc_command_s is None else record.ttc_command_s


def excused(record) -> bool:
    """The tick says that another arm forces it."""
    return any(arm.reason == "other_arm" for arm in record.arms.values())


class Steps:
    """Whether commands go from tick to tick as the joints can accelerate."""

    def __init__(self, cell):
        self._cell, self._before = cell, np.zeros(cell.model.nv)

    def check(self, record) -> None:
        for arm in self._cell.arms:
            change = np.abs(record.command_rad_s[arm.dofs] - self._before[arm.dofs])
            reach = arm.acceleration_limit_rad_s2 * self._cell.period_s
            assert (change <= reach * (1 + 1e-6) + 1e-9).all(), (record.tick, arm.name)
        self._before = record.command_rad_s


angles = st.tuples(*[st.floats(-0.85, 0.85)] * 3)
slide = st.tuples(st.floats(-0.3, 0.3))


def random_cell(homes, t_min, criterion, third):
    """Two planar arms and, if wanted, a slider between them; all go for the first arm's tool."""
    content = cells.duet(t_min_s=t_min, criterion=criterion)
    for arm, home_rad in zip(content["arm"], homes, strict=True):
        turned = (
            np.array([2.0, 0.3, 0.3]) if arm["name"] == "surgeon" else np.array([1.1, 0.3, 0.3])
        )
        arm["home_rad"] = [float(x) for x in turned + np.array(home_rad)]
    content["arm"][1]["job"] = [{"kind": "meet", "arm": "surgeon"}]
    if third is not None:
        content["arm"].append(
            {
                "name": "runner",
                "model": "slider",
                "base_position_m": [0.0, 0.35, -0.06],
                "base_wxyz": [0.0, 0.0, 0.0, 1.0],
                "home_rad": [float(third[0])],
                "priority": 2,
                "job": [{"kind": "meet", "arm": "surgeon", "speed_m_s": 0.3}],
            }
        )
    return content


@settings(
    max_examples=12,
    deadline=None,
    derandomize=True,
    suppress_health_check=list(HealthCheck),
    phases=[
        Phase.explicit,
        Phase.generate,
    ],  # an example takes a second: shrinking would take minutes
)
@given(
    homes=st.tuples(angles, angles),
    t_min=st.floats(0.6, 2.0),
    criterion=st.sampled_from(["artc", "artc_approaching", "armd", "none"]),
    third=st.one_of(st.none(), slide),
    speed=st.floats(-0.6, 0.6),
)
def test_the_commanded_time_to_collision_is_never_below_t_min(
    tmp_path, homes, t_min, criterion, third, speed
):
    """Over cells of two and three arms of mixed models, with a first arm that moves as it likes.

    Only where the other arm's own motion forces it may the time be shorter, and then the tick says so.
    """
    cell = cells.build(tmp_path, random_cell(homes, t_min, criterion, third))
    data = home(cell)
    mujoco.mj_forward(cell.model, data)
    distances = [
        mujoco.mj_geomDistance(cell.model, data, g, h, 10, None) for g, h in cell.pairs.geoms
    ]
    if min(distances) <= cell.scenario.control.d_min_m:
        return
    steps = Steps(cell)
    for record in play(cell, 150, lambda k: speed * np.sin(k / 10.0) * np.array([1.0, 0.5, 0.2])):
        steps.check(record)
        if not excused(record) and record.pair_distance_m.min() > cell.scenario.control.d_min_m:
            assert commanded_ttc(record) >= 0.99 * t_min, (record.tick, record.ttc_command_s)


@settings(
    max_examples=12,
    deadline=None,
    derandomize=True,
    suppress_health_check=list(HealthCheck),
    phases=[Phase.explicit, Phase.generate],
)
@given(
    homes=st.tuples(angles, angles),
    t_min=st.floats(0.3, 2.0),
    speed=st.floats(0.05, 0.8),
)
def test_among_arms_that_stand_there_is_no_excuse(tmp_path, homes, t_min, speed):
    """Fast approaches, of which some turn harder than the joints can: then off the path, but never below t_min."""
    content = random_cell(homes, t_min, "none", None)
    content["arm"][1]["job"][0] |= {"speed_m_s": speed}
    cell = cells.build(tmp_path, content)
    steps = Steps(cell)
    for record in play(cell, 250):
        steps.check(record)
        if record.pair_distance_m.min() > cell.scenario.control.d_min_m:
            assert commanded_ttc(record) >= 0.99 * t_min, (record.tick, record.ttc_command_s)


def test_an_arm_that_can_do_no_better_than_stand_says_the_other_is_the_cause(tmp_path):
    """The surgeon comes to a nurse that has reached its place: below t_min, but with the reason."""
    cell = cells.build(tmp_path, cells.duet())
    towards = np.array([0.5, 0.5, 0.0])
    short = [r for r in play(cell, 350, lambda k: towards) if commanded_ttc(r) < 0.99]
    assert short, "the surgeon must really have come too fast for this to mean anything"
    assert all(r.arms["nurse"].reason == "other_arm" for r in short)


def test_commands_keep_speed_and_acceleration_limits(cell, exchange):
    previous = np.zeros(cell.model.nv)
    for record in exchange:
        for arm in cell.arms:
            command = record.command_rad_s[arm.dofs]
            assert (np.abs(command) <= arm.velocity_limit_rad_s + 1e-9).all()
            change = np.abs(command - previous[arm.dofs]) / cell.period_s
            assert (change <= arm.acceleration_limit_rad_s2 * (1 + 1e-6) + 1e-6).all()
        previous = record.command_rad_s


def test_a_meeting_ends_at_the_smallest_distance_and_is_left_at_full_factor(exchange):
    """Approach, stand at d_min, dwell, go back unslowed, whatever the distance."""
    jobs = [job for job, _ in groupby(record.arms["nurse"].job for record in exchange)]
    assert jobs == ["start", "meet", "dwell", "retreat", "done"]
    assert min(r.pair_distance_m.min() for r in exchange) == pytest.approx(0.01, abs=2e-4)
    leaving = [
        record.arms["nurse"].scale
        for record in exchange
        if record.arms["nurse"].job == "retreat"
        and (record.pair_rate_m_s[record.pair_distance_m < 0.15] > 1e-4).all()
    ]
    assert len(leaving) > 100
    assert min(leaving) == 1.0


def test_with_the_factor_goes_the_clock_of_the_path(cell, exchange):
    """A slowed arm stays on its path: its clock advances by the factor, its tool error stays small."""
    clock, slowed = None, 0
    for record in exchange:
        nurse = record.arms["nurse"]
        if clock is not None and nurse.job == clock[0] == "meet" and clock[2] < 1.0:
            assert nurse.path_s - clock[1] == pytest.approx(clock[2] * cell.period_s)
            assert nurse.tool_error_m < 1e-3
            slowed += 1
        clock = (nurse.job, nurse.path_s, nurse.scale)
    assert slowed > 50
