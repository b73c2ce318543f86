"""From an input that finds the arm standing to the first motion, and no other."""

from __future__ import annotations

import pytest

from workcell.live.latency import GIVE_UP_S, LatencyMeter


class Clock:
    now_s = 0.0

    def __call__(self):
        return self.now_s


@pytest.fixture
def timed():
    clock = Clock()
    return LatencyMeter(clock), clock


def test_the_time_from_input_to_motion_counts_once(timed):
    meter, clock = timed
    for start_s, took_s in ((1.0, 0.02), (5.0, 0.04), (9.0, 0.03)):
        clock.now_s = start_s
        meter.observe(0.0)
        meter.begin()
        clock.now_s += took_s / 2
        meter.begin()  # more of the same motion
        meter.observe(0.0)
        clock.now_s = start_s + took_s
        meter.observe(0.1)
        meter.begin()  # the arm moves already
    summary = meter.summary()
    assert summary.count == 3
    assert summary.median_s == pytest.approx(0.03)
    assert 0.039 < summary.p99_s <= 0.04


def test_an_input_that_moves_nothing_has_no_latency(timed):
    meter, clock = timed
    meter.observe(0.0)
    meter.begin()
    clock.now_s = 1.1 * GIVE_UP_S
    meter.observe(0.0)
    clock.now_s += 1.0
    meter.observe(0.1)
    assert meter.summary().count == 0
    assert meter.summary().median_s is None
