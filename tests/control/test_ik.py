"""The program solved is the one mink's tasks and limits define, every limit bites, and no fallback is out of reach."""

from __future__ import annotations

from importlib.metadata import version

import mink
import mujoco
import numpy as np
import pytest

from tests import cells
from workcell import scenario
from workcell.control import criteria
from workcell.control.ik import (
    OPTIMAL,
    STOPPED,
    TASK_ONLY,
    TASK_SOFT,
    ArmIk,
    CriterionTask,
    JointLimit,
    ToolTask,
    TtcLimit,
)
from workcell.control.ik.qp import ProgramSpace
from workcell.control.ik.quadprog import KNOWN_VERSION
from workcell.control.proximity import PairGeometry
from workcell.motion.path import Target, standing
from workcell.scene import cell as scene

DT = 0.002
FREE = criteria.NullspaceObjective(np.zeros((7, 7)), np.zeros(7))
NO_ROWS = np.zeros((0, 7)), np.zeros(0)


class Bench:
    """One arm of the handover cell with its inverse kinematics, put into any state."""

    def __init__(self, cell: scene.Cell):
        self.cell = cell
        self.arm = cell.arms[0]
        self.configuration = mink.Configuration(cell.model)
        cell.place_home(self.configuration.data)
        self.configuration.update()
        self.geometry = PairGeometry(
            cell.model, [tuple(pair) for pair in cell.pairs.geoms], cell.sensor_adr
        )
        self.ik = ArmIk(
            self.arm, nv=cell.model.nv, dt_s=DT, task_gain_per_s=10.0, criterion_gain=8.0
        )
        self.at(self.arm.home_rad)

    def at(self, q_rad) -> Bench:
        qpos = self.configuration.data.qpos.copy()
        qpos[self.arm.qpos] = q_rad
        self.configuration.update(qpos)
        mujoco.mj_sensorPos(self.cell.model, self.configuration.data)
        return self

    def pose(self) -> tuple[np.ndarray, np.ndarray]:
        pose = self.configuration.get_transform_frame_to_world(self.arm.tool_site_name, "site")
        return pose.translation(), pose.rotation().wxyz

    def aim(self, velocity=(0, 0, 0), turn=(0, 0, 0)) -> np.ndarray:
        position, wxyz = self.pose()
        target = Target(position, wxyz, np.array(velocity, float), np.array(turn, float))
        return self.ik.aim(self.configuration, target)

    def solve(self, previous=None, objective=FREE, rows=NO_ROWS):
        return self.ik.solve(
            self.configuration, np.zeros(7) if previous is None else previous, objective, *rows
        )


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    return scene.build(scenario.load("handover"), tmp_path_factory.mktemp("handover"))


@pytest.fixture
def bench(cell):
    return Bench(cell)


def test_solve_gives_what_mink_gives_with_its_tasks_limits_and_constraints(bench):
    """Over random states, targets, velocities, criteria and bounds; the second opinion is mink's own assembly."""
    random = np.random.default_rng(3)
    arm, ik, binding = bench.arm, bench.ik, 0
    for _ in range(60):
        bench.at(arm.home_rad + random.uniform(-0.5, 0.5, 7))
        bench.aim(random.normal(0, 0.05, 3), random.normal(0, 0.1, 3))
        near = bench.geometry.measure(bench.configuration.data)
        name = random.choice(criteria.CRITERIA)
        objective = criteria.objective(
            name,
            near.distance_m,
            random.normal(size=len(near.distance_m)),
            near.jacobian[:, arm.dofs],
        )
        previous = ik.aim(bench.configuration, ik_target := bench_target(bench, random))
        previous = previous + random.normal(0, 2e-3, 7)
        rows = near.jacobian[:8]
        bounds = rows[:, arm.dofs] @ previous - np.abs(random.normal(0, 5e-3, 8))
        solution = ik.solve(bench.configuration, previous, objective, rows[:, arm.dofs], bounds)
        if solution.status != OPTIMAL:
            continue
        ik.criterion.objective = objective
        ik.ttc.give(rows, bounds)
        ik.tool.follow(ik_target)
        velocity = mink.solve_ik(
            bench.configuration, ik.tasks, DT, "daqp",
            limits=ik.limits, constraints=ik.constraints, primal_tol=1e-12,
        )  # fmt: skip
        np.testing.assert_allclose(solution.velocity_rad_s, velocity[arm.dofs], atol=2e-6)
        low, high = ik.limit.bounds(bench.configuration.data.qpos[arm.qpos], DT)
        at_limit = np.minimum(solution.velocity_rad_s - low, high - solution.velocity_rad_s) < 1e-6
        on_row = np.abs(rows[:, arm.dofs] @ solution.velocity_rad_s - bounds) < 1e-8
        binding += bool(at_limit.any() or on_row.any())
    assert binding > 20, "limits and rows must really have taken part"


def bench_target(bench: Bench, random: np.random.Generator) -> Target:
    position, wxyz = bench.pose()
    return Target(
        position + random.normal(0, 1e-4, 3),
        wxyz,
        random.normal(0, 0.05, 3),
        random.normal(0, 0.1, 3),
    )


def test_the_tool_does_what_its_target_does(bench):
    """Error correction and the target's own twist, feed-forward not weakened by the gain."""
    random = np.random.default_rng(5)
    for _ in range(10):
        bench.at(bench.arm.home_rad + random.uniform(-0.3, 0.3, 7))
        v, w = random.normal(0, 0.05, 3), random.normal(0, 0.05, 3)
        task = bench.aim(v, w)
        jacobian = bench.configuration.get_frame_jacobian(bench.arm.tool_site_name, "site")
        rotation = bench.configuration.get_transform_frame_to_world(
            bench.arm.tool_site_name, "site"
        ).rotation()
        for velocity in (task, bench.solve(previous=task).velocity_rad_s):
            twist = jacobian[:, bench.arm.dofs] @ velocity
            np.testing.assert_allclose(rotation.apply(twist[:3]), v, atol=1e-5)
            np.testing.assert_allclose(rotation.apply(twist[3:]), w, atol=1e-5)


def test_a_tool_error_is_corrected_at_the_given_rate(bench):
    position, wxyz = bench.pose()
    previous = bench.ik.aim(bench.configuration, standing(position + np.array([0.001, 0, 0]), wxyz))
    velocity = bench.solve(previous=previous).velocity_rad_s
    bench.at(bench.arm.home_rad + velocity * DT)
    assert bench.pose()[0][0] - position[0] == pytest.approx(0.001 * 10.0 * DT, rel=0.01)


def test_self_motion_follows_the_criterion_and_leaves_the_tool(bench):
    bench.aim()
    near = bench.geometry.measure(bench.configuration.data)
    objective = criteria.objective(
        "artc", near.distance_m, np.zeros(len(near.distance_m)), near.jacobian[:, bench.arm.dofs]
    )
    with_criterion = bench.solve(objective=objective)
    assert with_criterion.status == OPTIMAL
    assert objective.linear @ with_criterion.velocity_rad_s < -1e-6, "ARTC falls"
    jacobian = bench.configuration.get_frame_jacobian(bench.arm.tool_site_name, "site")
    assert np.abs(jacobian[:, bench.arm.dofs] @ with_criterion.velocity_rad_s).max() < 1e-8
    assert np.abs(bench.solve().velocity_rad_s).max() < 1e-9, "without it nothing moves"


# ---------------------------------------------------------------- every limit bites


def limited(bench: Bench, **changes) -> np.ndarray:
    """What is commanded for a tool velocity of 0.3 m/s upwards with some limits relaxed or tightened."""
    arm = bench.arm
    wide = {
        "lower_rad": np.full(7, -np.inf),
        "upper_rad": np.full(7, np.inf),
        "velocity_limit_rad_s": np.full(7, 1e3),
        "acceleration_limit_rad_s2": np.full(7, 1e6),
    }
    changed = type(arm)(**{**arm.__dict__, **wide, **changes})
    bench.ik = ArmIk(
        changed, nv=bench.cell.model.nv, dt_s=DT, task_gain_per_s=10.0, criterion_gain=0.0
    )
    bench.aim((0.0, 0.0, 0.3))
    return bench.solve().velocity_rad_s


def test_the_velocity_limit_bites(bench):
    free = limited(bench)
    limit = np.abs(free) * 0.5 + 1e-3
    held = limited(bench, velocity_limit_rad_s=limit)
    assert (np.abs(free) > limit).any()
    assert (np.abs(held) <= limit).all()
    assert np.isclose(np.abs(held), limit).any()


def test_the_acceleration_limit_bites(bench):
    free = limited(bench)
    limit = np.full(7, 2.0)
    held = limited(bench, acceleration_limit_rad_s2=limit)
    assert np.abs(free).max() > 2.0 * DT
    assert np.abs(held).max() == pytest.approx(2.0 * DT)


def test_the_position_limit_bites(bench):
    """A joint a hair before its stop may go on only as fast as it can still brake."""
    free = limited(bench)
    joint = int(np.argmax(np.abs(free)))
    side = "upper_rad" if free[joint] > 0 else "lower_rad"
    stop = np.full(7, np.inf if side == "upper_rad" else -np.inf)
    stop[joint] = bench.arm.home_rad[joint] + np.sign(free[joint]) * 1e-5
    limit = np.full(7, 20.0)
    held = limited(bench, **{side: stop, "acceleration_limit_rad_s2": limit})
    assert abs(held[joint]) * DT <= 1e-5 + overshoot_rad(limit)[joint]
    only_acceleration = limited(bench, acceleration_limit_rad_s2=limit)
    assert abs(only_acceleration[joint]) > 1.5 * abs(held[joint])


def overshoot_rad(acceleration_limit_rad_s2) -> np.ndarray:
    """How far braking in whole periods may pass a stop that continuous braking just reaches: a dt²/8."""
    return acceleration_limit_rad_s2 * DT**2 / 8


def test_a_joint_beyond_its_range_is_led_back(bench):
    limit = JointLimit(bench.arm, nv=bench.cell.model.nv)
    beyond = bench.arm.upper_rad + 0.01
    low, high = limit.bounds(beyond, DT)
    assert (high < 0).all()
    assert (low <= high).all()


@pytest.mark.parametrize("speed", [0.0, 0.5, 5.0])
def test_the_box_is_never_empty_and_never_lets_a_joint_hit_its_stop(bench, speed):
    """Driven at its stop at full command, a joint comes to rest before it."""
    arm, limit = bench.arm, JointLimit(bench.arm, nv=bench.cell.model.nv)
    q, velocity = arm.upper_rad - 0.3, np.minimum(speed, arm.velocity_limit_rad_s)
    for _ in range(4000):
        limit.previous_rad_s = velocity
        low, high = limit.bounds(q, DT)
        assert (low <= high).all()
        velocity, q = high, q + high * DT
        assert (q <= arm.upper_rad + 1.001 * overshoot_rad(arm.acceleration_limit_rad_s2)).all()
    np.testing.assert_allclose(q, arm.upper_rad, atol=5e-3)


def test_the_rows_of_the_time_to_collision_bite(bench):
    bench.aim()
    near = bench.geometry.measure(bench.configuration.data)
    rows = near.jacobian[:, bench.arm.dofs]
    tool = bench.configuration.get_frame_jacobian(bench.arm.tool_site_name, "site")
    self_motion = np.linalg.svd(tool[:, bench.arm.dofs])[2][-1]
    pair = int(np.argmax(np.abs(rows @ self_motion)))
    push = criteria.NullspaceObjective(np.zeros((7, 7)), rows[pair] * 10.0)
    free = bench.solve(objective=push).velocity_rad_s
    rate = rows[pair] @ free
    assert rate < 0
    held = bench.solve(objective=push, rows=(rows[pair : pair + 1], np.array([rate / 2])))
    assert held.status == OPTIMAL
    assert rows[pair] @ held.velocity_rad_s == pytest.approx(rate / 2, abs=1e-8)


# ---------------------------------------------------------------- the ladder


def test_each_fallback_answers_where_the_one_before_cannot(bench):
    bench.aim()
    assert bench.solve().status == OPTIMAL
    impossible = np.eye(7)[:1], np.array([1e3])
    assert bench.solve(rows=impossible).status == TASK_ONLY
    bench.aim((3.0, 0.0, 0.0))
    soft = bench.solve(rows=impossible)
    assert soft.status == TASK_SOFT, "from rest the tool cannot take on three metres a second"
    low, high = bench.ik.limit.bounds(bench.arm.home_rad, DT)
    assert (low <= soft.velocity_rad_s).all()
    assert (soft.velocity_rad_s <= high).all()


def test_a_solver_that_fails_on_every_fallback_stops_the_arm(bench, monkeypatch):
    bench.aim((0.1, 0.0, 0.0))
    bench.ik.space.solver.addresses[0] = 0
    monkeypatch.setattr("daqp.solve", lambda *a, **k: (np.ones(7), 0.0, -1, {}))
    solution = bench.solve()
    assert solution.status == STOPPED
    np.testing.assert_array_equal(solution.velocity_rad_s, 0.0)


def test_a_solution_that_is_no_number_is_not_taken(bench, monkeypatch):
    bench.aim()
    bench.ik.space.solver.addresses[0] = 0
    monkeypatch.setattr("daqp.solve", lambda *a, **k: (np.full(7, np.nan), 0.0, 1, {}))
    assert bench.solve().status == STOPPED


def test_the_c_function_answers_as_its_wrapper():
    """Bit for bit: solved, infeasible, and missed softly where that is all there is."""
    rng, answered = np.random.default_rng(3), 0
    for k in range(60):
        space, root = ProgramSpace(7), rng.normal(size=(7, 7))
        space.H[...], space.c[...] = root @ root.T + np.eye(7), rng.normal(size=7)
        space.rows[:9] = rng.normal(size=(9, 7))
        space.lower[:16] = np.concatenate([np.full(7, -1.0), rng.normal(0.0, 0.3 + k % 3, size=9)])
        space.upper[:16] = np.concatenate([np.ones(7), np.full(8, 1e30), space.lower[15:16]])
        space.sense[7:15], space.sense[15] = rng.choice([0, 8], size=8), 5
        space.smallest[...], space.largest[...] = -1.0, 1.0
        direct = space.solve(9)
        space.solver.addresses[0] = 0
        through_wrapper = space.solve(9)
        assert (direct is None) == (through_wrapper is None)
        if direct is not None:
            np.testing.assert_array_equal(direct, through_wrapper)
            answered += 1
    assert 20 < answered < 60
    assert version("daqp") == KNOWN_VERSION, "see whether daqp's structures are still the same"


@pytest.mark.parametrize(
    ("where", "value"),
    [
        (where, value)
        for where in ("objective", "rows", "bound", "target")
        for value in (np.nan, np.inf)
    ]
    + [("previous", np.nan)],
)
def test_numbers_that_are_not_finite_never_reach_the_solver(bench, where, value):
    if where == "target":
        with pytest.raises(FloatingPointError, match="surgeon"):
            bench.aim((value, 0.0, 0.0))
        return
    bench.aim()
    linear, rows, bound, previous = np.zeros(7), np.ones((1, 7)), np.array([-1.0]), np.zeros(7)
    {"objective": linear, "rows": rows[0], "bound": bound, "previous": previous}.get(
        where, np.zeros(1)
    )[0] = value
    with pytest.raises(FloatingPointError, match="surgeon"):
        bench.solve(previous, criteria.NullspaceObjective(np.zeros((7, 7)), linear), (rows, bound))


# ---------------------------------------------------------------- the parts by themselves


def test_the_parts_work_with_any_configuration_of_mink(tmp_path):
    """A tool driven at another arm with mink alone: with the limit it stops short, without it does not."""
    cell = cells.build(tmp_path, cells.duet())
    geometry = PairGeometry(cell.model, [tuple(p) for p in cell.pairs.geoms], cell.sensor_adr)
    nurse = cell.arms[1]

    def drive(limits: list[mink.Limit]) -> tuple[float, float]:
        configuration = mink.Configuration(cell.model)
        cell.place_home(configuration.data)
        configuration.update()
        goal = configuration.data.site("surgeon/tool").xpos.copy()
        wxyz = configuration.get_transform_frame_to_world("nurse/tool", "site").rotation().wxyz
        tool = ToolTask("nurse/tool", gain_per_s=1.0, dt_s=0.01)
        tool.follow(standing(goal, wxyz))
        calm = CriterionTask(nurse.dofs, nv=cell.model.nv, dt_s=0.01, gain=0.0)
        smallest, shortest = np.inf, np.inf
        for _ in range(400):
            velocity = mink.solve_ik(
                configuration, [tool, calm], 0.01, "daqp", damping=1e-9, limits=limits
            )
            mujoco.mj_sensorPos(cell.model, configuration.data)
            near = geometry.measure(configuration.data)
            smallest = min(smallest, near.distance_m.min())
            rate = near.rate_m_s(velocity)
            closing = rate < -1e-9
            shortest = min([shortest, *(-near.distance_m[closing] / rate[closing])])
            configuration.integrate_inplace(velocity, 0.01)
        return smallest, shortest

    free = drive([])
    held = drive([TtcLimit(geometry, t_min_s=0.5)])
    assert free[0] < 0, "unlimited it runs into the other arm"
    assert held[0] > 0
    assert held[1] > 0.49


def test_the_limit_needs_pairs_or_rows(bench):
    with pytest.raises(ValueError, match="PairGeometry or rows"):
        TtcLimit(t_min_s=1.0).compute_qp_inequalities(bench.configuration, DT)
