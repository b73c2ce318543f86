"""Faults of a live stream: each has its name, its time to react, and none makes the arm leap."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workcell import scenario
from workcell.motion.operators.live import LiveOperator
from workcell.motion.operators.samples import Sample
from workcell.motion.setpoint import STATES

HOME = np.array([0.4, 0.5, 0.4])
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
DT = 0.002
FRAME_S = 0.02
SPEED, ACCELERATION = 0.3, 1.5


def at(t: float) -> np.ndarray:
    """Where the hand is: slowly along x."""
    return HOME + np.array([0.05 * np.sin(t), 0.0, 0.0])


class Stream:
    """A live operator fed with 50 Hz samples, some of them spoilt."""

    def __init__(self, **options):
        options = {
            "max_speed_m_s": SPEED,
            "max_acceleration_m_s2": ACCELERATION,
            "stale_s": 0.1,
            "late_s": 0.1,
        } | options
        live = scenario.Live.model_validate({"kind": "live", **options})
        self.operator = LiveOperator(live, HOME, UPRIGHT, period_s=DT)
        self.tick = 0
        self.states: list[str] = []
        self.path: list[np.ndarray] = []

    def run(self, until_s, sample=lambda t: Sample(t, at(t), UPRIGHT)):
        """Until a time, with what `sample` makes of the time of a frame; None sends nothing."""
        while self.tick * DT < until_s - 1e-9:
            t = self.tick * DT
            if self.tick % round(FRAME_S / DT) == 0:
                made = sample(t)
                if made is not None:
                    self.operator.offer(made)
            setpoint = self.operator.setpoint(t)
            self.states.append(setpoint.state)
            self.path.append(setpoint.target.position_m)
            self.tick += 1
        return self

    def reaction_s(self, start_s, state):
        """Time from the start of a fault until its name is given."""
        first = round(start_s / DT)
        return self.states.index(state, first) * DT - start_s

    def assert_no_leap(self):
        velocity = np.diff(np.array(self.path), axis=0) / DT
        assert np.linalg.norm(velocity, axis=1).max() <= SPEED * 1.001
        change = np.linalg.norm(np.diff(velocity, axis=0), axis=1) / DT
        assert change.max() <= 3.001 * ACCELERATION


def leap(t):
    return Sample(t, at(t) + np.array([0.0, 0.3, 0.0]), UPRIGHT)


FAULTS = {
    # What is sent during the fault, its name, and the longest time until it is named.
    "stale": (lambda t: None, 0.1 + FRAME_S),
    "not_finite": (lambda t: Sample(t, np.array([np.nan, 0, 0]), UPRIGHT), FRAME_S),
    "not_unit": (lambda t: Sample(t, at(t), 1.1 * UPRIGHT), FRAME_S),
    "late": (lambda t: Sample(t - 0.15, at(t), UPRIGHT), FRAME_S),
    "repeated": (lambda t: Sample(0.98, at(0.98), UPRIGHT), FRAME_S),
    "out_of_order": (lambda t: Sample(0.5, at(0.5), UPRIGHT), FRAME_S),
    "jump": (leap, FRAME_S),
    "frozen": (lambda t: Sample(t, at(0.98), UPRIGHT), 0.2 + FRAME_S),
}


@pytest.mark.parametrize("name", FAULTS)
def test_every_fault_is_named_in_time_and_left_without_a_leap(name):
    sample, reaction_s = FAULTS[name]
    stream = Stream(frozen_s=0.2, jump_confirm_s=10.0).run(1.0)
    if name == "late":
        # A late sample that is also older than the last good one is out of order: leave a hole first.
        stream.run(1.0 + FRAME_S)
        fault_s = 1.2
        stream.run(fault_s, lambda t: None)
    else:
        fault_s = 1.0
    stream.run(fault_s + 0.5, sample)
    assert stream.reaction_s(fault_s, name) <= reaction_s + 1e-9
    # Whatever comes, the arm stays at the last good pose.
    assert stream.path[-1] == pytest.approx(at(1.0), abs=2e-3)
    stream.run(3.5)
    assert stream.states[-1] == "valid"
    assert stream.path[-1] == pytest.approx(at(3.5), abs=0.01)
    stream.assert_no_leap()


def test_without_samples_the_arm_waits_at_its_start():
    stream = Stream().run(1.0, lambda t: None)
    assert set(stream.states) == {"waiting"}
    assert all(np.array_equal(p, HOME) for p in stream.path)


def test_a_leap_that_stays_is_believed_and_crossed_slowly():
    stream = Stream(jump_confirm_s=0.1).run(1.0).run(4.0, leap)
    named = np.array(stream.states)
    assert stream.reaction_s(1.0, "jump") <= FRAME_S + 1e-9
    assert 0.1 - 1e-9 <= stream.reaction_s(1.0, "catching_up") <= 0.1 + 2 * FRAME_S
    assert named[-1] == "valid"
    assert stream.path[-1] == pytest.approx(leap(4.0).position_m, abs=0.01)
    stream.assert_no_leap()


def test_a_mouse_that_rests_is_no_fault():
    stream = Stream(frozen_s=0.0).run(1.0).run(2.0, lambda t: Sample(t, at(0.98), UPRIGHT))
    assert set(stream.states[round(0.1 / DT) :]) == {"valid"}


_pose = st.one_of(st.floats(-1.0, 1.0), st.sampled_from([np.nan, np.inf, -np.inf, 1e300, 0.0]))
_sample = st.one_of(
    st.none(),
    st.tuples(st.floats(-0.3, 0.3), st.tuples(_pose, _pose, _pose), st.tuples(*[_pose] * 4)),
    st.tuples(st.just(0.0), st.tuples(*[st.floats(0.2, 0.5)] * 3), st.just((1.0, 0.0, 0.0, 0.0))),
)


@settings(max_examples=30, deadline=None)
@given(st.lists(_sample, min_size=1, max_size=25))
def test_no_stream_whatever_makes_the_target_leap_or_lose_its_senses(spoilt):
    stream = Stream()
    sent = iter(spoilt)

    def sample(t):
        made = next(sent, None)
        if made is None:
            return None
        return Sample(t + made[0], np.array(made[1]), np.array(made[2]))

    with np.errstate(over="ignore"):
        stream.run(len(spoilt) * FRAME_S + 0.3, sample)
    assert set(stream.states) <= set(STATES)
    assert np.isfinite(stream.path).all()
    stream.assert_no_leap()
