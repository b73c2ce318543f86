"""Nearest points that jump along near-parallel capsules: the rate is bounded at the other end before they get there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from workcell.control.gate import gate
from workcell.control.gate.rows import no_ends

from . import gate_cell
from .gate_cell import bench, planar_arm

T_MIN_S = 1.0


def beside_a_post(axis: str = "0.25 0 0.05 0.25 0 0.5"):
    """A link 0.4 m long that turns about its lower end, beside a post that is parallel to it at angle 0."""
    return bench(
        planar_arm("own", "0 0 0", 1)
        + f'<geom name="post" type="capsule" size="0.04" fromto="{axis}"/>',
        "own",
        acceleration=2.0,
    )


def turned_past(cell, *, ends: bool) -> float:
    """The smallest time to collision, as a share of t_min, while a command turns the link past the post's direction."""
    q, last, worst = np.array([-0.9]), np.zeros(1), np.inf
    for _ in range(200):
        cell.place(q)
        rows = cell.rows()
        if not ends:
            jump, farther, pair = no_ends(1)
            rows = replace(rows, jump=jump, jump_farther_m=farther, jump_pair=pair)
        rules = gate_cell.rules(t_min_s=T_MIN_S)
        answer = gate(np.array([1.0]), cell.state(last), cell.limits, rows, rules)
        last = answer.command
        rate = float(rows.own[0] @ last)
        if rate < 0.0:
            worst = min(worst, -rows.distance_m[0] / rate / T_MIN_S)
        q = q + 0.01 * last
    assert q[0] > 0.0  # it got past where the axes are parallel
    return worst


def test_the_rate_is_bounded_before_the_nearest_points_jump():
    assert turned_past(beside_a_post(), ends=True) >= 0.99
    # The jump is real: with the nearest points' row alone the rate is more than twice what it may be.
    assert turned_past(beside_a_post(), ends=False) < 0.5


def test_ends_of_capsules_that_are_not_parallel_have_no_rows():
    cell = beside_a_post("0.25 -0.3 0.2 0.25 0.3 0.2")
    cell.place(np.array([-0.2]))
    assert len(cell.rows().jump) == 0


@pytest.mark.parametrize("seed", range(5))
def test_rows_are_the_derivatives_of_the_ends_distances(seed):
    """Against the distances of the ends worked out another way, and finite differences."""
    rng = np.random.default_rng(seed)
    tilt = rng.uniform(-0.04, 0.04, 2)
    cell = bench(
        planar_arm("own", "0 0 0")
        + f'<geom name="post" type="capsule" size="0.05" fromto="0.3 0.1 0.5 {0.3 + tilt[0]} {0.1 + tilt[1]} 1.3"/>',
        "own",
    )
    q = rng.uniform(-0.06, 0.06, 3)
    cell.place(q)
    rows = cell.rows()
    assert len(rows.jump) == 12
    distance = apart(cell)
    near = rows.distance_m[rows.jump_pair]
    np.testing.assert_allclose(near + rows.jump_farther_m, np.maximum(distance, near), atol=1e-9)
    h, slopes = 1e-6, np.empty((12, 3))
    for k in range(3):
        for sign in (1.0, -1.0):
            cell.place(q + sign * h * np.eye(3)[k])
            slopes[:, k] = sign * apart(cell) + (slopes[:, k] if sign < 0.0 else 0.0)
    np.testing.assert_allclose(rows.jump, slopes / (2.0 * h), atol=1e-5)


def apart(cell) -> np.ndarray:
    """(4 P,) distance of each end of either capsule to the other one."""
    found, data, model = [], cell.data, cell.model
    for i, j in cell.geoms():
        for one, other in ((i, j), (j, i)):
            axis = data.geom_xmat[one].reshape(3, 3)[:, 2] * model.geom_size[one, 1]
            for end in (1.0, -1.0):
                ray = data.geom_xpos[one] + end * axis - data.geom_xpos[other]
                along = data.geom_xmat[other].reshape(3, 3)[:, 2]
                s = np.clip(ray @ along, -model.geom_size[other, 1], model.geom_size[other, 1])
                found.append(np.linalg.norm(ray - s * along) - model.geom_size[[i, j], 0].sum())
    return np.array(found)
