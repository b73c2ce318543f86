"""The latch stays latched, and braking keeps direction and limits and comes to rest."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from workcell.guard import CheckState, HaltLatch, Verdict, brake, braking_time_s
from workcell.guard.halt import STANDING_RAD_S

PERIOD_S = 0.002
velocities = arrays(float, 7, elements=st.floats(-6.3, 6.3, allow_subnormal=True))
limits = arrays(float, 7, elements=st.floats(0.5, 20.0))


def verdict(state: CheckState, tick: int = 0) -> Verdict:
    return Verdict(state, tick + 1, tick, 0, 0.004, ("a", "b"), None, f"because {state}")


@pytest.mark.parametrize("state", list(CheckState))
def test_everything_but_clear_and_off_latches(state: CheckState):
    latch = HaltLatch(PERIOD_S)
    assert latch.trip(verdict(state), 3) == (state not in ("clear", "off"))


def test_only_a_reset_releases_and_the_first_cause_stays():
    latch = HaltLatch(PERIOD_S)
    assert latch.report() is None
    latch.trip(verdict(CheckState.HALT, 10), 12)
    assert latch.trip(verdict(CheckState.CLEAR, 11), 13)
    assert latch.trip(verdict(CheckState.LOST, 12), 14)
    report = latch.report()
    assert report is not None
    assert (report.state, report.tick, report.age_ticks) == (CheckState.HALT, 12, 2)
    latch.reset()
    assert not latch.latched
    assert latch.report() is None
    assert not latch.trip(verdict(CheckState.CLEAR), 15)


def test_the_report_measures_the_stop():
    latch = HaltLatch(PERIOD_S)
    latch.observe(0, "nurse", 9.0, np.ones(2))
    latch.trip(verdict(CheckState.HALT, 100), 100)
    qvel, lever_m = np.array([0.4, -0.2]), 0.5
    for tick in range(100, 400):
        latch.observe(tick, "nurse", lever_m * abs(qvel[0]), qvel)
        qvel = brake(qvel, np.array([2.0, 2.0]), PERIOD_S)
    report = latch.report()
    assert report is not None
    # v^2 / 2a and v / a of the tool, with half a tick's way more for counting from the start.
    v, a = lever_m * 0.4, lever_m * 2.0
    assert report.speed_m_s == {"nurse": pytest.approx(v)}
    assert report.stopping_time_s == {"nurse": pytest.approx(v / a, abs=1.5 * PERIOD_S)}
    assert report.stopping_distance_m == {"nurse": pytest.approx(v * v / (2 * a), abs=v * PERIOD_S)}


def test_an_arm_that_still_moves_has_no_stopping_time():
    latch = HaltLatch(PERIOD_S)
    latch.trip(verdict(CheckState.LATE), 0)
    latch.observe(0, "nurse", 0.1, np.array([0.1]))
    report = latch.report()
    assert report is not None
    assert report.stopping_time_s == {"nurse": None}


@given(velocities, limits)
def test_braking_keeps_direction_and_limits_and_uses_them(v, a):
    after = brake(v, a, PERIOD_S)
    moving = np.abs(v) > STANDING_RAD_S
    if moving.any():
        change = np.abs(after - v)
        assert np.all(change[moving] <= a[moving] * PERIOD_S * (1 + 1e-9))
        share = after[moving] / v[moving]
        assert np.all((share >= 0.0) & (share < 1.0))
        assert np.allclose(share, share[0], atol=1e-9)
        # Some joint brakes as hard as it may, unless all are at rest already.
        used = change[moving] / (a[moving] * PERIOD_S)
        assert np.isclose(used.max(), 1.0) or np.all(after == 0.0)
    else:
        assert np.all(after == 0.0)


@settings(max_examples=30)
@given(velocities, limits)
def test_braking_ends_in_the_stated_time(v, a):
    ticks = int(np.ceil(braking_time_s(v, a) / PERIOD_S)) + 1
    for _ in range(ticks):
        v = brake(v, a, PERIOD_S)
    assert np.all(v == 0.0)


def test_braking_refuses_what_it_cannot_use():
    with pytest.raises(ValueError, match=r"command_rad_s\[1\] is not finite"):
        brake(np.array([0.0, np.nan]), np.ones(2), PERIOD_S)
    with pytest.raises(ValueError, match=r"acceleration_rad_s2\[0, 1\] must be above 0"):
        brake(np.zeros(2), np.array([0.0, np.nan]), PERIOD_S)
