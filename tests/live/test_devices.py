"""Keys that are held move at a speed, sticks by their deflection, and presses count once."""

from __future__ import annotations

import numpy as np
import pytest

from workcell.live.devices import (
    DEAD_ZONE,
    GAMEPAD_SPEED_M_S,
    KEY_SPEED_M_S,
    KEY_TURN_RAD_S,
    SLOW_SHARE,
    DeviceInput,
    WindowKeys,
    is_ours,
    key_motion,
    stick_motion,
)

X, Y, MINUS_X = (1, 0, 0), (0, 1, 0), (-1, 0, 0)
RIGHT, UP, SHIFT = 262, 265, 340


def test_a_held_key_moves_at_its_speed():
    way, turn = key_motion([X], [Y], 0.5)
    assert way == pytest.approx([0.5 * KEY_SPEED_M_S, 0.0, 0.0])
    assert turn == pytest.approx([0.0, 0.5 * KEY_TURN_RAD_S, 0.0])


def test_two_held_keys_are_no_faster_than_one_and_opposite_ones_cancel():
    way, _ = key_motion([X, Y], [], 1.0)
    assert np.linalg.norm(way) == pytest.approx(KEY_SPEED_M_S)
    way, _ = key_motion([X, MINUS_X], [], 1.0)
    assert not way.any()


def test_shift_is_slow():
    way, _ = key_motion([X], [], 1.0, slow=True)
    assert way[0] == pytest.approx(SLOW_SHARE * KEY_SPEED_M_S)


def test_a_stick_moves_by_speed_and_time_and_a_released_one_not_at_all():
    still = stick_motion(np.full(6, 0.9 * DEAD_ZONE), 0.1)
    assert not np.any(still)
    way, turn = stick_motion(np.array([1.0, 0, 0, 0, 0, -1.0]), 0.1)
    assert way == pytest.approx([GAMEPAD_SPEED_M_S * 0.1, 0, 0])
    assert turn[2] < 0


def test_keys_of_the_window_move_while_they_are_held_and_count_once_when_pressed():
    down: set[int] = {RIGHT, UP}
    keys = WindowKeys(lambda wanted: down & set(wanted))
    for key in (ord("7"), ord("7"), ord("6"), ord("8"), 325, ord("0")):
        keys.press(key)
    asked = keys.take(0.1)
    step = 0.1 * KEY_SPEED_M_S / np.sqrt(2)
    assert asked.way_m == pytest.approx([step, step, 0.0])
    assert (asked.t_min_steps, asked.criterion_steps, asked.entry) == (1, 1, "above")
    assert asked.release
    assert not asked.quit
    down.clear()
    later = keys.take(0.1)
    assert not later.way_m.any()
    assert later.t_min_steps == 0
    down.update({RIGHT, SHIFT})
    assert keys.take(0.1).way_m[0] == pytest.approx(0.1 * SLOW_SHARE * KEY_SPEED_M_S)
    keys.press(ord("9"))
    assert asked.and_then(keys.take(0.1)).quit


def test_what_drives_is_kept_from_the_viewer_and_the_rest_is_not():
    assert is_ours(RIGHT)
    assert is_ours(ord("9"))
    assert not is_ours(ord("C"))
    assert not is_ours(256)  # Escape


def test_inputs_of_two_frames_add_up():
    both = DeviceInput(way_m=np.ones(3), reset=True).and_then(DeviceInput(way_m=np.ones(3)))
    assert both.way_m == pytest.approx([2.0, 2.0, 2.0])
    assert both.reset
