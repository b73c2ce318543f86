"""What of tele-operation needs no screen: the pace, the keys, the stick, the stream's listener."""

from __future__ import annotations

import numpy as np
import pytest

from workcell.errors import InputError
from workcell.live.devices import DEAD_ZONE, GAMEPAD_SPEED_M_S, STEP_M, STEP_RAD, Keys, stick_motion
from workcell.live.teleop import GIVE_UP_S, Pace, teleop


class Clock:
    """A clock that only sleeping and working move."""

    def __init__(self):
        self.now_s = 100.0
        self.slept_s = 0.0

    def __call__(self):
        return self.now_s

    def sleep(self, time_s):
        self.now_s += time_s
        self.slept_s += time_s


def pace(work_s):
    """Ticks of 10 ms, each followed by work."""
    clock = Clock()
    keeper = Pace(0.01, clock=clock, sleep=clock.sleep)
    for tick, busy_s in enumerate(work_s):
        keeper.wait(tick)
        clock.now_s += busy_s
    return keeper.account, clock


def test_a_fast_run_is_held_back_to_the_clock():
    account, clock = pace([0.004] * 100)
    assert clock.now_s - 100.0 == pytest.approx(99 * 0.01 + 0.004)
    assert (account.ticks, account.missed, account.slipped_s) == (100, 0, 0.0)


def test_one_long_tick_is_counted_and_caught_up_with():
    account, clock = pace([0.004] * 10 + [0.055] + [0.004] * 89)
    assert 1 <= account.missed < 10
    assert account.worst_late_s == pytest.approx(0.045)
    assert account.slipped_s == 0.0
    assert clock.now_s - 100.0 == pytest.approx(99 * 0.01 + 0.004)


def test_a_run_too_slow_for_the_clock_slips_instead_of_racing():
    account, clock = pace([0.02] * 100)
    assert clock.slept_s == 0.0
    assert account.missed > 80
    assert account.worst_late_s < GIVE_UP_S + 0.02
    assert account.slipped_s == pytest.approx(1.0, abs=0.12)


def test_keys_move_and_turn_by_their_step():
    keys = Keys()
    for key in (262, 262, 263, 265, 266, 326, ord("7"), ord("7"), ord("6"), ord("8"), 32):
        keys.press(key)
    asked = keys.take(0.1)
    assert asked.way_m == pytest.approx([STEP_M, STEP_M, STEP_M])
    assert asked.turn_rad == pytest.approx([STEP_RAD, 0, 0])
    assert (asked.t_min_steps, asked.criterion_steps, asked.quit) == (1, 1, False)
    assert not keys.take(0.1).way_m.any()  # taken once
    keys.press(ord("9"))
    assert asked.and_then(keys.take(0.1)).quit


def test_a_stick_moves_by_speed_and_time_and_a_released_one_not_at_all():
    still = stick_motion(np.full(6, 0.9 * DEAD_ZONE), 0.1)
    assert not np.any(still)
    way, turn = stick_motion(np.array([1.0, 0, 0, 0, 0, -1.0]), 0.1)
    assert way == pytest.approx([GAMEPAD_SPEED_M_S * 0.1, 0, 0])
    assert turn[2] < 0


def test_tele_operation_needs_a_live_arm(tmp_path):
    from workcell import scenario

    with pytest.raises(InputError, match="no arm has an operator of kind 'live'"):
        teleop(scenario.load("handover"), tmp_path)
