"""The peers' laws, each against its own definition."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from workcell.control.strategies.program import least_squares
from workcell.control.strategies.ssm import largest_scale

positive = st.floats(1e-3, 5.0)


@given(
    gap=st.floats(0.0, 1.0),
    closing=st.floats(0.0, 2.0),
    deceleration=positive,
    other=st.floats(0.0, 2.0),
    reaction=st.floats(1e-3, 0.5),
)
def test_the_protective_separation_distance_is_just_kept(
    gap, closing, deceleration, other, reaction
):
    (scale,) = largest_scale(
        np.array([gap]), np.array([closing]), np.array([deceleration]), np.array([other]), reaction
    )

    def needed(s):
        speed = s * closing
        return (
            speed * reaction
            + speed**2 / (2.0 * deceleration)
            + other * (reaction + speed / deceleration)
        )

    assert 0.0 <= scale <= 1.0
    if closing == 0.0:
        assert scale == 1.0
        return
    if needed(0.0) > gap:
        assert scale == 0.0  # standing is not enough: what is left is to stand
        return
    assert needed(scale) <= gap + 1e-9
    if scale < 1.0:
        assert needed(min(1.0, scale + 1e-3)) > gap - 1e-9


def test_a_program_keeps_its_box_and_misses_a_row_only_where_the_box_leaves_no_other_way():
    H, c = np.eye(2), np.array([-1.0, 0.0])
    rows, low, high = np.array([[0.0, 1.0]]), -np.ones(2), np.ones(2)
    found = least_squares(H, c, rows, np.array([0.5]), low, high)
    assert np.allclose(found, [1.0, 0.5], atol=1e-6)
    found = least_squares(H, c, rows, np.array([3.0]), low, high)
    assert np.allclose(found[1], 1.0, atol=1e-6)
    assert least_squares(H, c * np.nan, rows, np.array([0.5]), low, high) is None
