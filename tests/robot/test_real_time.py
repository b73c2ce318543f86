"""On the clock, with robots in processes of their own: what is promised when one dies. Counts real time, so it is long."""

from __future__ import annotations

import pytest

from workcell.robot.measure import WATCHDOG_S, follow, kill

pytestmark = pytest.mark.long

STANDS_S = 0.5
"""Longest stop that is allowed here: watchdog or stale readings (0.12 s), braking at full deceleration, and a busy machine."""


def test_robots_follow_over_a_network_that_is_late():
    told = follow(0.02, 4.0, delay_s=0.002, jitter_s=0.002)
    assert told["stopped"] == ""
    assert told["stood"]
    assert told["ticks"] == 200
    assert told["age_s"]["median"] < 0.06


def test_a_dead_robot_stops_the_other():
    assert 0.0 < kill("robot").stood_s["nurse"] < STANDS_S


def test_a_dead_loop_leaves_robots_that_stop_by_themselves():
    stood = kill("loop").stood_s
    assert set(stood) == {"surgeon", "nurse"}
    assert all(WATCHDOG_S / 2 < time_s < STANDS_S for time_s in stood.values())


def test_a_dead_checker_stops_the_support_arm():
    assert 0.0 < kill("checker").stood_s["nurse"] < STANDS_S
