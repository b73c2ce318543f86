"""The gate's bounds against what really happens: every distance along a stop, the joints' ranges, the points' speeds."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workcell.control.laws import gate as laws
from workcell.control.laws import gate_box

from . import gate_cell
from .gate_cell import bench, planar_arm, seven_joint_arm, stop_states

DT = 0.01
POSTS = (
    '<geom name="post" type="capsule" size="0.05" fromto="0.45 0 0 0.45 0 0.9"/>'
    '<geom name="ball" type="sphere" size="0.1" pos="0.2 0.4 0.6"/>'
    '<geom name="block" type="box" size="0.15 0.1 0.2" pos="-0.5 0.2 0.4" euler="0.3 0.2 0.5"/>'
    '<geom name="floor" type="plane" size="3 3 1" pos="0 0 -0.3"/>'
)
TWO_BRANCHES = (
    '<body pos="0 0 0"><joint axis="0 0 1"/><geom name="own/trunk" type="capsule" size="0.08" fromto="0 0 0 0 0 0.3"/>'
    + gate_cell.serial_arm("own", "0.15 0 0.3", (0.3, 0.3), (0.04, 0.04), ("0 1 0", "1 0 0"))
    .replace("own/c", "own/right")
    .replace('name="own', 'name="own')
    + gate_cell.serial_arm(
        "left", "-0.15 0 0.3", (0.3, 0.3), (0.04, 0.04), ("0 1 0", "1 0 0")
    ).replace("left/c", "own/left")
    + "</body>"
)
CELLS = {
    "two seven-joint arms": lambda: bench(
        seven_joint_arm("own", "0 -0.35 0") + seven_joint_arm("other", "0 0.35 0") + POSTS,
        "own",
        speed=gate_cell.PA10_SPEED,
        acceleration=gate_cell.PA10_ACCELERATION,
    ),
    "two planar arms": lambda: bench(
        planar_arm("own", "-0.5 0 0") + planar_arm("other", "0.5 0 0", 2) + POSTS, "own"
    ),
    "links that are boxes": lambda: bench(
        seven_joint_arm("own", "0 -0.35 0", kind="box")
        + seven_joint_arm("other", "0 0.35 0")
        + POSTS,
        "own",
    ),
    "a slide": lambda: bench(
        gate_cell.serial_arm(
            "own", "0 0 0", (0.3, 0.3, 0.3), (0.05,) * 3, ("0 1 0", "1 0 0", "0 1 0")
        ).replace('type="hinge" axis="1 0 0"', 'type="slide" axis="1 0 0"')
        + POSTS,
        "own",
    ),
    "one joint": lambda: bench(planar_arm("own", "0 0 0", 1) + POSTS, "own"),
    "two branches of one arm": lambda: bench(TWO_BRANCHES + POSTS, "own"),
    "other shapes": lambda: bench(
        seven_joint_arm("own", "0 -0.35 0")
        .replace(
            'name="own/c6" type="capsule" size="0.03" fromto="0.01 0 0 0 0.02 0.08"',
            'name="own/c6" type="cylinder" size="0.05 0.08" euler="0.4 0.3 0"',
        )
        .replace(
            'name="own/c5" type="capsule" size="0.06" fromto="0.01 0 0 0 0.02 0.1"',
            'name="own/c5" type="mesh" mesh="wedge" pos="0.1 0 0"',
        )
        + POSTS,
        "own",
        assets='<mesh name="wedge" vertex="0 0 0 .3 0 0 0 .1 0 0 0 .1"/>',
    ),
}


@pytest.mark.parametrize("name", CELLS)
def test_no_distance_along_a_stop_is_smaller_than_its_bound(name, rng):
    """Every pair, at states drawn at random, along the whole stop; also where joints brake harder and unevenly."""
    cell = CELLS[name]()
    n, worst, tight, looked = len(cell.dofs), np.inf, [], 0
    for _ in range(60):
        qpos = rng.uniform(-np.pi, np.pi, cell.model.nq)
        if name == "a slide":
            qpos *= 0.3
        cell.place(qpos)
        rows = cell.rows()
        x = rng.uniform(-1.0, 1.0, n) * cell.limits.speed * rng.choice([0.1, 0.3, 1.0])
        margin = least_margins(cell, rows, x, reaction_s=DT)
        clear = rows.distance_m > 0.0
        deceleration = cell.limits.acceleration * rng.choice([1.0, 1.0, 3.0], n)
        least = np.full(len(rows.pair), np.inf)
        ways = stop_states(qpos[cell.dofs], x, deceleration, rng.choice([0.0, DT]), DT)
        for q in ways[:: max(1, len(ways) // 25)] + ways[-1:]:
            qpos[cell.dofs] = q
            cell.data.qpos[:] = qpos
            mujoco.mj_kinematics(cell.model, cell.data)
            least = np.minimum(least, cell.distances())
        worst = min(worst, float((least - margin)[clear].min(initial=np.inf)))
        tight.append(np.median((least - margin)[clear]))
        looked += int(clear.sum())
    assert looked > 50
    assert worst > -1e-7, f"bound broken by {-worst} m"
    assert np.median(tight) < 0.6  # the bound says something


def least_margins(cell, rows, x, *, reaction_s, ahead=(0.0, 0.0)):
    """(P,) the smallest margin over each pair's points."""
    n = len(x)
    travel, margin = np.empty((2, n)), np.empty(len(rows.low_m))
    low, high = (np.broadcast_to(np.asarray(a, float), n).copy() for a in ahead)
    laws.stop_travel(x, low, high, cell.limits.acceleration, reaction_s, travel)
    laws.stop_margins(travel, rows.first, rows.order, rows.rows, rows.levers, rows.low_m, margin)
    return np.minimum.reduceat(margin, rows.first[:-1])


def test_the_bound_covers_what_is_still_ahead_of_the_joints(rng):
    """Commands in flight, lag and noise: the joint may be anywhere in `ahead` when its stop begins."""
    cell = CELLS["two seven-joint arms"]()
    n, worst = len(cell.dofs), np.inf
    for _ in range(40):
        qpos = rng.uniform(-np.pi, np.pi, cell.model.nq)
        cell.place(qpos)
        rows = cell.rows()
        x = 0.3 * rng.uniform(-1.0, 1.0, n) * cell.limits.speed
        low, high = -0.05 * rng.random(n), 0.05 * rng.random(n)
        margin = least_margins(cell, rows, x, reaction_s=DT, ahead=(low, high))
        start = qpos[cell.dofs] + np.where(rng.random(n) < 0.5, low, high)
        clear = rows.distance_m > 0.0
        for q in stop_states(start, x, cell.limits.acceleration, DT, DT)[::4]:
            qpos[cell.dofs] = q
            cell.data.qpos[:] = qpos
            mujoco.mj_kinematics(cell.model, cell.data)
            worst = min(worst, float((cell.distances() - margin)[clear].min(initial=np.inf)))
    assert worst > -1e-7


@pytest.mark.parametrize("degenerate", ["parallel", "point on an axis", "touching"])
def test_the_bound_holds_in_degenerate_places(degenerate, rng):
    """Straight arm beside a parallel post, where axes have no common normal and points lie on joint axes."""
    gap = {"parallel": 0.05, "point on an axis": 0.03, "touching": 1e-6}[degenerate]
    arm = gate_cell.serial_arm(
        "own", "0 0 0", (0.3, 0.3, 0.3), (0.05,) * 3, ("0 0 1", "0 1 0", "0 0 1")
    ).replace("0.01 0 0 0 0.02", "0 0 0 0 0")
    cell = bench(
        arm
        + f'<geom name="post" type="capsule" size="0.05" fromto="{0.1 + gap} 0 0 {0.1 + gap} 0 0.9"/>',
        "own",
    )
    for _ in range(40):
        cell.place(np.zeros(3))
        rows = cell.rows()
        assert np.allclose(rows.distance_m, gap, atol=1e-9)
        x = rng.uniform(-1.0, 1.0, 3)
        margin = least_margins(cell, rows, x, reaction_s=DT)
        for q in stop_states(np.zeros(3), x, cell.limits.acceleration, DT, DT)[::3]:
            cell.data.qpos[:] = q
            mujoco.mj_kinematics(cell.model, cell.data)
            found = cell.distances()
            # In contact MuJoCo's depth of crossing capsules is not the bound's business.
            assert ((found - margin > -1e-7) | (found < 0.0)).all()
            assert (margin[found < 0.0] < 0.0).all()


def test_a_pair_whose_points_lie_on_the_joint_axes_still_has_its_joints():
    """Joints are masked by structure: a lever arm of zero now is not one of zero after the joints beyond it have turned."""
    arm = gate_cell.serial_arm(
        "own", "0 0 0", (0.3, 0.3), (0.05, 0.05), ("0 0 1", "0 1 0")
    ).replace("0.01 0 0 0 0.02", "0 0 0 0 0")
    cell = bench(arm + '<geom name="post" type="sphere" size="0.05" pos="0.4 0 0.6"/>', "own")
    cell.place(np.zeros(2))
    rows = cell.rows()
    assert rows.levers[-1, 0] == pytest.approx(0.0, abs=1e-12)  # the tip is on the first axis
    assert rows.order[-1].tolist() == [1, 0]
    both = least_margins(cell, rows, np.array([1.0, 1.0]), reaction_s=DT)
    one = least_margins(cell, rows, np.array([0.0, 1.0]), reaction_s=DT)
    assert both[-1] < one[-1]


def test_gradient_of_the_bound_against_differences(rng):
    cell = CELLS["two seven-joint arms"]()
    n = len(cell.dofs)
    for _ in range(10):
        cell.place(rng.uniform(-np.pi, np.pi, cell.model.nq))
        rows = cell.rows()
        x = 0.4 * rng.uniform(-1.0, 1.0, n) * cell.limits.speed
        pair_of = np.repeat(np.arange(len(rows.pair)), np.diff(rows.first))
        nothing, travel = np.zeros(n), np.empty((2, n))
        for e in rng.choice(len(rows.low_m), 20, replace=False):
            gradient, margins = np.empty(n), []
            laws.stop_gradient(
                e,
                pair_of[e],
                x,
                nothing,
                nothing,
                cell.limits.acceleration,
                DT,
                rows.order,
                rows.rows,
                rows.levers,
                gradient,
            )
            for step in (1e-6, -1e-6):
                for k in range(n):
                    moved, margin = x.copy(), np.empty(len(rows.low_m))
                    moved[k] += step
                    laws.stop_travel(moved, nothing, nothing, cell.limits.acceleration, DT, travel)
                    laws.stop_margins(
                        travel, rows.first, rows.order, rows.rows, rows.levers, rows.low_m, margin
                    )
                    margins.append(margin[e])
            difference = (np.array(margins[:n]) - np.array(margins[n:])) / 2e-6
            np.testing.assert_allclose(gradient, difference, atol=1e-6)


@settings(max_examples=100, deadline=None)
@given(
    room=st.floats(1e-9, 3.0),
    speed=st.floats(0.0, 6.0),
    a=st.floats(0.1, 20.0),
    period=st.sampled_from([0.001, 0.002, 0.01, 0.02]),
)
def test_a_joint_never_passes_its_end_stop_between_ticks(room, speed, a, period):
    """A ticked loop that asks for full speed towards the stop: not even by the a dt²/8 of the continuous formula."""
    last = min(speed, gate_box.largest_stopping_speed(room, a, period, 0.0))
    position, box, bounds = 0.0, np.empty((2, 1)), np.empty((2, 1), dtype=np.int64)
    one = np.ones(1)
    for _ in range(400):
        at = np.array([position])
        gate_box.next_commands(
            at,
            at,
            np.array([last]),
            np.zeros(1),
            -one,
            room * one,
            6.0 * one,
            a * one,
            np.inf * one,
            period,
            box,
            bounds,
        )
        assert box[0, 0] <= box[1, 0]
        assert box[0, 0] >= last - a * period - 1e-12
        last = box[1, 0]
        position += last * period
        assert position <= room * (1.0 + 1e-12) + 1e-15


@pytest.mark.parametrize("latency", [0.0, 0.013])
def test_the_largest_stopping_speed_is_the_inverse_of_the_ticked_stop(rng, latency):
    for _ in range(200):
        a, period, room = (
            rng.uniform(0.2, 9.0),
            rng.choice([0.002, 0.01]),
            10.0 ** rng.uniform(-6, 0),
        )
        v = gate_box.largest_stopping_speed(room, a, period, latency)
        way, u = v * (latency + period), v
        while u > 0.0:
            u = max(0.0, u - a * period)
            way += u * period
        assert way == pytest.approx(room, rel=1e-9)


def test_what_the_joints_cannot_exceed_comes_first():
    """Beyond its end stop, a fast joint: braking is what is left; at rest there: only the way back."""
    box, bounds = np.empty((2, 2)), np.empty((2, 2), dtype=np.int64)
    one = np.ones(2)
    at = np.array([1.1, 1.1])
    gate_box.next_commands(
        at,
        at,
        np.array([0.5, 0.0]),
        np.zeros(2),
        -one,
        one,
        2.0 * one,
        one,
        np.inf * one,
        0.01,
        box,
        bounds,
    )
    np.testing.assert_allclose(box, [[0.49, -0.01], [0.49, 0.0]])
    assert bounds[1].tolist() == [gate_box.ACCELERATION, gate_box.POSITION]


def test_jerk_bounds_the_change_of_acceleration_and_gives_way_to_the_end_stop():
    box, bounds = np.empty((2, 2)), np.empty((2, 2), dtype=np.int64)
    one, dt = np.ones(2), 0.01
    # The second joint is at its end stop and may only go back, whatever its jerk.
    at, last, change = np.array([0.0, 1.0]), np.array([0.1, 0.005]), np.array([0.5, 0.5])
    gate_box.next_commands(at, at, last, change, -one, one, one, one, 20.0 * one, dt, box, bounds)
    np.testing.assert_allclose(
        box[:, 0], [0.1 + 0.5 * dt - 20 * dt**2, 0.1 + 0.5 * dt + 20 * dt**2]
    )
    assert bounds[:, 0].tolist() == [gate_box.JERK, gate_box.JERK]
    assert box[1, 1] == pytest.approx(0.0)


def test_point_speeds_bound_every_point_of_a_link(rng):
    """Against MuJoCo's own velocity of points drawn on the surfaces of all links; and tight at one of them."""
    cell = CELLS["links that are boxes"]()
    model, data, n = cell.model, cell.data, len(cell.dofs)
    for _ in range(5):
        cell.place(rng.uniform(-np.pi, np.pi, model.nq))
        x, links = rng.uniform(-1.0, 1.0, n), cell.gate.links(data)
        bound = links.speeds_m_s(x)
        for g in np.unique(links.geom):
            size, jacobian = model.geom_size[g], np.zeros((3, model.nv))
            speeds = []
            for local in rng.uniform(-1.0, 1.0, (50, 3)) * size:
                at = data.geom_xpos[g] + data.geom_xmat[g].reshape(3, 3) @ local
                mujoco.mj_jac(model, data, jacobian, None, at, model.geom_bodyid[g])
                speeds.append(np.linalg.norm(jacobian[:, cell.dofs] @ x))
            assert max(speeds) <= bound[links.geom == g].max() + 1e-9
        c = int(rng.integers(len(bound)))
        steps = 1e-6 * np.eye(n)
        difference = [
            (links.speeds_m_s(x + h)[c] - links.speeds_m_s(x - h)[c]) / 2e-6 for h in steps
        ]
        np.testing.assert_allclose(links.gradient(c, x), difference, atol=1e-6)
