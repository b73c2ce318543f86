"""The hand follows the wish on a leash, no faster than a hand, and says when it cannot be followed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from workcell.live.marker import (
    HAND_M_S,
    LEASH_M,
    LEASH_RAD,
    SETTLED_S,
    SHORT_M,
    Marker,
    is_short,
)
from workcell.motion.orientation import rotation_between

UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
HOME = (np.zeros(3), UPRIGHT)
DT = 0.01
coordinates = st.floats(-3.0, 3.0, allow_nan=False)


def follow(marker: Marker, tool=HOME, *, short=False, speed=0.0, time_s=5.0):
    for _ in range(round(time_s / DT)):
        marker.follow(DT, tool, short, speed)
    return marker.hand


def test_the_hand_comes_to_a_wish_within_the_leash():
    marker = Marker(*HOME)
    marker.place(np.array([0.2, 0.0, 0.0]), UPRIGHT)
    assert follow(marker)[0] == pytest.approx([0.2, 0.0, 0.0])


@given(wish=st.tuples(*[coordinates] * 3), turn=st.tuples(*[st.floats(-1.0, 1.0)] * 4))
def test_the_hand_is_never_farther_from_the_tool_than_the_leash(wish, turn):
    wxyz = np.array(turn) if np.linalg.norm(turn) > 0.1 else UPRIGHT
    marker = Marker(*HOME)
    marker.place(np.array(wish), wxyz)
    position, orientation = follow(marker)
    assert np.linalg.norm(position) <= LEASH_M + 1e-9
    assert np.linalg.norm(rotation_between(UPRIGHT, orientation)) <= LEASH_RAD + 1e-6
    assert np.linalg.norm(orientation) == pytest.approx(1.0)


@given(wish=st.tuples(*[coordinates] * 3))
def test_the_hand_is_no_faster_than_a_hand(wish):
    marker = Marker(*HOME)
    marker.place(np.array(wish), UPRIGHT)
    before = marker.hand[0]
    for _ in range(30):
        after = marker.follow(DT, HOME, False, 0.0)[0]
        assert np.linalg.norm(after - before) <= HAND_M_S * DT + 1e-12
        before = after


def test_keys_do_not_push_the_wish_off_its_leash():
    marker = Marker(*HOME)
    for _ in range(100):
        marker.push(np.array([0.05, 0.0, 0.0]), np.zeros(3))
    assert marker.wish[0] == pytest.approx([LEASH_M, 0.0, 0.0])


def test_a_tool_that_stands_short_of_its_target_is_out_of_reach_until_it_is_not():
    marker = Marker(*HOME)
    marker.held = True
    marker.place(np.array([1.0, 0.0, 0.0]), UPRIGHT)
    follow(marker, short=True, speed=0.2)
    assert not marker.out_of_reach  # it is still on its way
    follow(marker, short=True, time_s=SETTLED_S + 2 * DT)
    assert marker.out_of_reach
    assert marker.wish[0] == pytest.approx([1.0, 0.0, 0.0])  # the gizmo is in somebody's hand
    marker.held = False
    follow(marker, short=True, time_s=0.1)
    assert marker.wish[0] == pytest.approx([0.0, 0.0, 0.0])  # let go of, it is back at the tool
    assert marker.out_of_reach
    follow(marker, short=False, time_s=2 * DT)
    assert not marker.out_of_reach


def test_with_an_open_clutch_the_hand_stands_and_closing_it_moves_nothing():
    marker = Marker(*HOME)
    marker.clutch(True)
    marker.place(np.array([0.2, 0.1, 0.0]), UPRIGHT)
    assert follow(marker)[0] == pytest.approx([0.0, 0.0, 0.0])
    marker.clutch(False)
    assert marker.wish[0] == pytest.approx([0.0, 0.0, 0.0])
    assert follow(marker)[0] == pytest.approx([0.0, 0.0, 0.0])


def test_short_is_beyond_the_lag_of_a_tool_in_motion():
    assert is_short(SHORT_M * 1.01, 0.0)
    assert not is_short(SHORT_M * 0.99, 0.0)
    assert is_short(0.0, 1.0)
