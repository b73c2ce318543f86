"""The gate as a whole: what passes is not touched, what fails is replaced, and no adversary gets through it."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from workcell.control.gate import (
    CLEARANCE_M,
    Gated,
    GateRows,
    GateRules,
    JointLimits,
    JointState,
    ahead,
    braking,
    gate,
)
from workcell.errors import WorkcellError

from . import gate_cell
from .gate_cell import bench, planar_arm, seven_joint_arm

POSTS = (
    '<geom name="post" type="capsule" size="0.05" fromto="0.45 0 0 0.45 0 0.9"/>'
    '<geom name="block" type="box" size="0.15 0.1 0.2" pos="-0.5 -0.2 0.4" euler="0.3 0.2 0.5"/>'
    '<geom name="floor" type="plane" size="3 3 1" pos="0 0 -0.2"/>'
)


def pa10s():
    """Two arms of seven joints among posts; the second stands."""
    return bench(
        seven_joint_arm("own", "0 -0.3 0") + seven_joint_arm("other", "0 0.3 0") + POSTS,
        "own",
        speed=gate_cell.PA10_SPEED,
        acceleration=gate_cell.PA10_ACCELERATION,
        reach=2.6,
    )


def planars():
    return bench(
        planar_arm("own", "-0.5 0 0") + planar_arm("other", "0.5 0 0.1") + POSTS, "own", reach=3.0
    )


def ask(cell, command, last=None, rules=None, **options) -> Gated:
    """One look at the present configuration."""
    n = len(cell.dofs)
    return gate(
        np.asarray(command, float),
        cell.state(np.zeros(n) if last is None else np.asarray(last, float)),
        cell.limits,
        cell.rows(),
        rules or gate_cell.rules(),
        **options,
    )


# ---------------------------------------------------------------- what passes and what does not


def test_a_command_far_from_everything_passes_unchanged():
    cell = bench(
        planar_arm("own", "0 0 0") + '<geom name="post" type="sphere" size="0.1" pos="3 0 3"/>',
        "own",
    )
    cell.place(np.array([0.2, 0.3, 0.1]))
    command = np.array([0.01, -0.01, 0.02])
    answer = ask(cell, command)
    assert answer.how == "passed"
    assert answer.command is command


@pytest.mark.parametrize(
    ("last", "command", "reason"),
    [
        (0.0, 0.5, "acceleration"),
        (1.45, 1.6, "speed"),
        (0.0, np.nan, "not_finite"),
        (0.0, np.inf, "not_finite"),
    ],
)
def test_what_the_joints_cannot_do_is_named(last, command, reason):
    cell = bench(
        planar_arm("own", "0 0 0", 1) + '<geom name="far" type="sphere" size="0.1" pos="9 0 9"/>',
        "own",
        acceleration=20.0 if reason == "speed" else 2.0,
    )
    cell.place(np.zeros(1))
    answer = ask(cell, [command], [last])
    assert answer.reasons[0] == reason
    assert np.isfinite(answer.command).all()
    assert abs(answer.command[0] - last) <= cell.limits.acceleration[0] * 0.01 + 1e-12


def one_joint_before_a_ball(gap: float):
    """A joint that turns its link into a ball."""
    return bench(
        planar_arm("own", "0 0 0", 1)
        + f'<geom name="ball" type="sphere" size="0.1" pos="{0.14 + gap} 0 0.3"/>',
        "own",
        acceleration=2.0,
    )


def test_time_to_collision_is_kept_and_the_pair_named():
    cell = one_joint_before_a_ball(0.2)
    cell.place(np.zeros(1))
    last = np.array([1.0])
    answer = ask(cell, [1.0], last)
    assert answer.how == "nearest"
    assert "time_to_collision" in answer.reasons
    assert answer.pair == 0
    # As hard as the joint can brake is not enough at once: that is told.
    assert answer.command[0] == pytest.approx(0.98)
    assert answer.missed_pair == 0
    assert answer.missed_m_s > 0.0


def test_a_stop_that_does_not_fit_is_refused_and_braking_is_the_answer():
    cell = one_joint_before_a_ball(0.05)
    cell.place(np.zeros(1))
    answer = ask(cell, [1.2], [1.2], gate_cell.rules(t_min_s=1e-3))
    assert answer.reasons[-1] == "stop"
    assert answer.how == "braking"
    assert not answer.verified
    assert answer.command[0] == pytest.approx(1.18)


def test_the_nearest_command_is_the_largest_that_stops_in_time():
    """One joint: what is given in place of a faster command is the fastest that passes by itself."""
    cell = one_joint_before_a_ball(0.16)
    limits = replace(cell.limits, acceleration=np.array([100.0]), speed=np.array([30.0]))
    cell.limits = limits
    cell.place(np.zeros(1))
    rules = gate_cell.rules(t_min_s=1e-3)
    low, high = 0.0, 30.0
    for _ in range(50):
        middle = np.array([0.5 * (low + high)])
        fails = ask(cell, middle, middle, rules).replaced
        low, high = (low, middle[0]) if fails else (middle[0], high)
    assert low > 2.0
    answer = ask(cell, [low + 0.3], [low + 0.3], rules)
    assert answer.how == "nearest"
    assert answer.reasons == ("stop",)
    assert answer.verified
    assert answer.command[0] == pytest.approx(low, rel=1e-3)


def test_pairs_that_are_to_meet_know_no_standoff_and_no_halt():
    cell = one_joint_before_a_ball(0.008)
    cell.place(np.zeros(1))
    rules = gate_cell.rules(d_min_m=0.01, standoff_m=0.02)
    command = np.array([0.01])
    assert ask(cell, command, command, rules).replaced
    assert not ask(cell, command, command, rules, meeting=np.array([True])).replaced
    assert not ask(cell, -command, -command, rules).replaced  # leaving is not slowed


def test_the_predicted_rate_of_others_tightens_what_is_left():
    cell = one_joint_before_a_ball(0.1)
    cell.place(np.zeros(1))
    row = cell.rows().own[0, 0]
    command = np.array([-0.08 / row])
    assert not ask(cell, command, command).replaced
    assert ask(cell, command, command, other_m_s=np.array([-0.05])).replaced
    # What already closes faster than standing can keep asks for no opening: that is the strategy's to give.
    answer = ask(cell, np.zeros(1), np.zeros(1), other_m_s=np.array([-1.0]))
    assert not answer.replaced


def test_what_stands_is_not_closed_on_for_the_sake_of_what_another_arm_presses():
    """A joint that moves towards a post as a hand follows it: it can brake for the post or go on fleeing from the hand."""
    rows = GateRows(
        pair=np.array([4, 9]),
        distance_m=np.array([0.05, 0.2]),
        own=np.array([[-1.0, 0.0], [1.0, 1.0]]),
        first=np.array([0, 1, 2]),
        order=np.array([[0, -1], [1, 0]]),
        rows=np.array([[-1.0, 0.0], [1.0, 1.0]]),
        levers=np.ones((2, 2)),
        low_m=np.array([0.05, 0.2]),
        jump=np.empty((0, 2)),
        jump_farther_m=np.empty(0),
        jump_pair=np.empty(0, dtype=np.intp),
    )
    limits = JointLimits(*(np.full(2, x) for x in (-9.0, 9.0, 1.0, 1.0, np.inf)))
    still, last = np.zeros(2), np.array([0.06, -0.2])
    state, rules = JointState(still, last, still, still, still), gate_cell.rules(t_min_s=1.0)
    # The post allows the first joint 0.05; the hand, which comes at 0.15, asks for first + second >= -0.05.
    answer = gate(last, state, limits, rows, rules, other_m_s=np.array([0.0, -0.15]))
    np.testing.assert_allclose(answer.command, [0.05, -0.19], atol=1e-6)
    assert answer.missed_pair == 9
    # A hand that stands asks for nothing.
    answer = gate(last, state, limits, rows, rules, other_m_s=np.zeros(2))
    np.testing.assert_allclose(answer.command, [0.05, -0.2], atol=1e-6)


def test_in_contact_only_opening_passes():
    cell = one_joint_before_a_ball(-0.02)
    cell.place(np.zeros(1))
    assert cell.rows().distance_m[0] < 0.0
    assert ask(cell, [0.05], [0.05]).command[0] < 0.05
    assert ask(cell, [-0.05], [-0.05]).how == "passed"
    assert ask(cell, [0.0], [0.0]).how == "passed"


def test_no_point_is_faster_than_the_cap():
    cell = bench(
        planar_arm("own", "0 0 0") + '<geom name="far" type="sphere" size="0.1" pos="9 0 9"/>',
        "own",
        acceleration=100.0,
    )
    cell.place(np.zeros(3))
    last = np.array([0.5, 0.2, 0.0])
    answer = ask(
        cell, last, last, gate_cell.rules(point_speed_m_s=0.25), links=cell.gate.links(cell.data)
    )
    assert answer.reasons == ("point_speed",)
    assert answer.how == "nearest"
    assert cell.gate.links(cell.data).speeds_m_s(answer.command).max() == pytest.approx(
        0.25, rel=1e-4
    )


def test_a_cap_that_the_joints_cannot_reach_at_once_is_told():
    cell = bench(
        planar_arm("own", "0 0 0") + '<geom name="far" type="sphere" size="0.1" pos="9 0 9"/>',
        "own",
    )
    cell.place(np.zeros(3))
    last = np.array([0.8, 0.8, 0.0])
    answer = ask(
        cell, last, last, gate_cell.rules(point_speed_m_s=0.25), links=cell.gate.links(cell.data)
    )
    assert answer.speed_m_s is not None
    assert answer.speed_m_s > 0.25
    np.testing.assert_allclose(answer.command[:2], 0.78)


def test_a_command_of_the_wrong_shape_and_rows_that_are_not_finite_are_refused():
    cell = one_joint_before_a_ball(0.1)
    cell.place(np.zeros(1))
    with pytest.raises(
        WorkcellError, match=r"command has shape \(2,\); must be that of the joints"
    ):
        ask(cell, [0.0, 0.0])
    rows = cell.rows()
    rows.low_m[0] = np.nan
    with pytest.raises(WorkcellError, match="low_m is not finite"):
        gate(np.zeros(1), cell.state(np.zeros(1)), cell.limits, rows, gate_cell.rules())
    with pytest.raises(WorkcellError, match="other_m_s is not finite"):
        ask(cell, [0.0], other_m_s=np.array([np.nan]))


def test_what_is_ahead_of_a_joint_counts_for_ranges_and_stops():
    """A joint whose commands are still in flight has less room than its measured position says."""
    cell = bench(
        planar_arm("own", "0 0 0", 1) + '<geom name="far" type="sphere" size="0.1" pos="9 0 9"/>',
        "own",
        reach=0.1,
    )
    cell.place(np.array([0.05]))
    last = np.array([0.35])
    low, high = ahead(np.full((10, 1), 0.35), 0.01)
    assert (low, high) == (0.0, pytest.approx(0.035))
    state = replace(cell.state(last), ahead_low=low, ahead_high=high)
    late = gate(last, state, cell.limits, cell.rows(), gate_cell.rules())
    assert ask(cell, last, last).how == "passed"
    assert late.reasons[0] in ("position", "acceleration")
    assert late.command[0] < 0.35


# ---------------------------------------------------------------- closed loops


ADVERSARIES = ("times three", "reversed", "random", "frozen", "nearest obstacle")


def adversary(kind: str, rng, cell, q, memory):
    """A command of a controller that has gone wrong, from what it meant to do: a slow wander."""
    n = len(q)
    memory.setdefault("goal", q + rng.uniform(-1.5, 1.5, n))
    if rng.random() < 0.01:
        memory["goal"] = q + rng.uniform(-1.5, 1.5, n)
    meant = np.clip(memory["goal"] - q, -0.4, 0.4)
    if kind == "times three":
        return 3.0 * meant
    if kind == "reversed":
        return -2.0 * meant
    if kind == "random":
        return rng.uniform(-1.0, 1.0, n) * cell.limits.speed
    if kind == "frozen":
        memory.setdefault("frozen", rng.uniform(-1.0, 1.0, n) * cell.limits.speed)
        return memory["frozen"]
    rows = cell.rows()
    return -cell.limits.speed * np.sign(rows.own[rows.distance_m.argmin()])


def closed_loop(cell, kind: str, seed: int, ticks: int, rules: GateRules, start=None):
    """Kinematic, one adversary in front of the gate: smallest distance by MuJoCo, worst range, worst change."""
    rng = np.random.default_rng(seed)
    n, memory = len(cell.dofs), {}
    q = clear_start(cell, rng) if start is None else start.copy()
    last = np.zeros(n)
    nearest, beyond, jump, unverified = np.inf, 0.0, 0.0, 0
    for _ in range(ticks):
        cell.place(q)
        nearest = min(nearest, cell.distances().min())
        command = adversary(kind, rng, cell, q[cell.dofs], memory)
        answer = gate(command, cell.state(last), cell.limits, cell.rows(), rules)
        jump = max(jump, float((np.abs(answer.command - last) / cell.limits.acceleration).max()))
        unverified += not answer.verified
        last = answer.command
        q[cell.dofs] += last * rules.period_s
        beyond = max(beyond, float((np.abs(q[cell.dofs]) - cell.limits.upper).max()))
    cell.place(q)
    return min(nearest, cell.distances().min()), beyond, jump / rules.period_s, unverified


def clear_start(cell, rng):
    """A configuration whose gated pairs are all a few centimetres apart."""
    for _ in range(2000):
        q = rng.uniform(-2.0, 2.0, cell.model.nq)
        cell.data.qpos[:] = q
        mujoco.mj_kinematics(cell.model, cell.data)
        if cell.distances().min() > 0.03:
            return q
    raise AssertionError("no clear start found")


@pytest.mark.parametrize("kind", ADVERSARIES)
@pytest.mark.parametrize(("build", "ticks", "seeds"), [(planars, 300, 3), (pa10s, 150, 2)])
@pytest.mark.parametrize("t_min_s", [1.0, 0.1])
def test_no_adversary_gets_an_arm_into_contact_or_out_of_its_range(
    kind, build, ticks, seeds, t_min_s
):
    cell = build()
    for seed in range(seeds):
        nearest, beyond, acceleration, _ = closed_loop(
            cell, kind, seed, ticks, gate_cell.rules(t_min_s=t_min_s)
        )
        assert nearest > 0.0
        assert beyond <= 1e-12
        assert acceleration <= 1.0 + 1e-9


def test_without_the_stop_test_an_adversary_gets_through():
    """The rates alone do not do it at a small t_min: what the test above holds is held by the gate's own test."""
    cell = planars()
    rules = gate_cell.rules(t_min_s=0.05)
    touched = 0
    for seed in range(6):
        rng = np.random.default_rng(seed)
        q, last = clear_start(cell, rng), np.zeros(3)
        for _ in range(300):
            cell.place(q)
            command = adversary("nearest obstacle", rng, cell, q[cell.dofs], {})
            rows = cell.rows()
            blind = replace(rows, low_m=rows.low_m + 100.0)
            last = gate(command, cell.state(last), cell.limits, blind, rules).command
            q[cell.dofs] += last * 0.01
        cell.place(q)
        touched += cell.distances().min() <= 0.0
    assert touched > 0


def test_four_arms_each_behind_its_own_gate_do_not_touch():
    """Each counts on the others to stand where they are; moving one after another makes that true."""
    places = ("-0.55 0 0", "0.55 0 0", "0 -0.55 0", "0 0.55 0")
    names = ("a", "b", "c", "d")
    body = "".join(
        gate_cell.serial_arm(name, at, (0.3, 0.3), (0.05, 0.05), ("0 1 0", "1 0 0"))
        for name, at in zip(names, places, strict=True)
    )
    cells = [bench(body, name, speed=1.0) for name in names]
    rng = np.random.default_rng(5)
    q, last = np.zeros(8), [np.zeros(2) for _ in names]
    for tick in range(400):
        mover = (tick // 100) % 4
        for k, cell in enumerate(cells):
            cell.place(q)
            wish = rng.uniform(-1.0, 1.0, 2) if k == mover else np.zeros(2)
            last[k] = gate(
                wish, cell.state(last[k]), cell.limits, cell.rows(), gate_cell.rules(t_min_s=0.2)
            ).command
            q[cell.dofs] += 0.01 * last[k]
            cell.place(q)
            assert cell.distances().min() > 0.0


def test_a_plain_velocity_controller_behind_the_gate():
    """The whole of it: a controller that knows nothing of obstacles drives to a goal beyond a post and is stopped before it."""
    cell = bench(planar_arm("own", "0 0 0") + POSTS, "own")
    rules = GateRules(period_s=0.01, t_min_s=1.0, d_min_m=0.01)
    q, last, before = np.array([-0.6, 0.3, 0.3]), np.zeros(3), np.zeros(3)
    goal, kept = np.array([1.2, 0.3, 0.3]), []
    for _ in range(1500):
        cell.place(q)
        wanted = np.clip(2.0 * (goal - q), -0.5, 0.5)
        state = cell.state(last, (last - before) / rules.period_s)
        answer = gate(wanted, state, cell.limits, cell.rows(), rules)
        last, before = answer.command, last
        q = q + rules.period_s * last
        kept.append(cell.distances().min())
    assert 0.0099 < min(kept) < 0.03
    assert np.abs(last).max() < 0.01
    assert answer.pair is not None


def test_braking_ends_where_it_began():
    limits = pa10s().limits
    last = np.array([0.5, -0.01, 0.0, 1.0, -2.0, 0.03, 0.0])
    slower = braking(last, limits, 0.01)
    assert (np.abs(slower) <= np.abs(last)).all()
    assert (np.sign(slower) * np.sign(last) >= 0.0).all()
    assert slower[1] == 0.0  # not beyond rest


def test_clearance_of_a_pair_nearer_than_the_clearance_is_half_of_what_is_left():
    cell = one_joint_before_a_ball(0.5 * CLEARANCE_M)
    cell.place(np.zeros(1))
    assert ask(cell, np.zeros(1)).how == "passed"  # standing always passes


@pytest.mark.long
@pytest.mark.parametrize("kind", ADVERSARIES)
def test_hundred_sabotaged_runs_without_contact(kind):
    """A hundred seeded runs of each adversary: the gate alone keeps the arm free."""
    for seed in range(100):
        build, t_min_s = (planars, pa10s)[seed % 2], (1.0, 0.1)[seed // 2 % 2]
        nearest, beyond, *_ = closed_loop(
            build(), kind, 1000 + seed, 300, gate_cell.rules(t_min_s=t_min_s)
        )
        assert nearest > 0.0
        assert beyond <= 1e-12
