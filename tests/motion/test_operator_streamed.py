"""A simulated person behind a bad stream: every fault shows, is seeded, and none makes the target leap."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from workcell import scenario
from workcell.motion.operators import make_operator
from workcell.motion.operators.streamed import StreamFaults

HOME = np.array([0.4, 0.5, 0.4])
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
DT = 0.01


def person(stream: dict, seed=0):
    settings = scenario.Human.model_validate(
        {"kind": "human", "sites": [{"position_m": [0.4, 0.6, 0.4]}], "stream": stream}
    )
    return make_operator(settings, HOME, UPRIGHT, seed=seed, name="surgeon", period_s=DT)


def play(stream: dict, duration_s=20.0, seed=0):
    operator = person(stream, seed)
    return [operator.setpoint(float(t)) for t in np.arange(0.0, duration_s, DT)]


class Still:
    """A hand that holds still."""

    def setpoint(self, time_s):
        return make_operator(scenario.Hold(kind="hold"), HOME, UPRIGHT).setpoint(time_s)


def sent(seconds=30.0, **stream):
    faults = StreamFaults(scenario.Stream(**stream), np.random.default_rng(3))
    return [
        (t, sample)
        for t in np.arange(0.0, seconds, DT).tolist()
        for sample in faults.until(t, Still())
    ]


def test_a_sound_stream_is_followed_at_its_rate():
    assert len(sent(rate_hz=10.0, seconds=10.0)) == 100
    states = Counter(w.state for w in play({"rate_hz": 30.0}))
    assert set(states) == {"valid"}


def test_jitter_delays_and_can_change_the_order():
    arrivals = sent(rate_hz=30.0, jitter_s=0.09)
    late = [t - sample.stamp_s for t, sample in arrivals]
    assert min(late) >= 0.0
    assert 0.06 < max(late) <= 0.09 + DT
    assert (np.diff([sample.stamp_s for _, sample in arrivals]) < 0).any()
    assert "out_of_order" in {w.state for w in play({"rate_hz": 30.0, "jitter_s": 0.09})}


def test_gaps_lose_samples_and_bursts_keep_them_back():
    whole = sent(rate_hz=20.0)
    gaps = sent(rate_hz=20.0, gap_probability=0.05, gap_s=(0.3, 0.6))
    assert len(gaps) < len(whole)
    hole = np.diff([sample.stamp_s for _, sample in gaps]).max()
    assert 0.3 <= hole <= 2.0
    bursts = sent(rate_hz=20.0, burst_probability=0.05, burst_s=0.3)
    assert max(Counter(t for t, _ in bursts).values()) >= 5
    assert max(t - s.stamp_s for t, s in bursts) == pytest.approx(0.3, abs=2 * DT)
    assert "stale" in {w.state for w in play({"gap_probability": 0.05, "gap_s": (0.3, 0.6)})}


def test_spikes_and_poses_at_the_origin_are_dropped_as_jumps():
    spikes = [s for _, s in sent(spike_probability=0.1, spike_m=0.5)]
    off = {round(float(np.linalg.norm(s.position_m - HOME)), 9) for s in spikes}
    assert off == {0.0, 0.5}
    lost = [s for _, s in sent(identity_probability=0.1)]
    assert any(not s.position_m.any() for s in lost)
    for stream in ({"spike_probability": 0.1}, {"identity_probability": 0.1}):
        setpoints = play(stream)
        assert "jump" in {w.state for w in setpoints}
        far = max(np.linalg.norm(w.target.position_m - HOME) for w in setpoints)
        assert far < 0.3, "the target stays where the person is"


ALL = {
    "rate_hz": 15.0,
    "jitter_s": 0.08,
    "gap_probability": 0.03,
    "burst_probability": 0.03,
    "spike_probability": 0.05,
    "identity_probability": 0.05,
}


def test_the_faults_are_seeded_and_leave_the_person_alone():
    one, again = play(ALL), play(ALL)
    other = play(ALL, seed=1)
    path = np.array([w.target.position_m for w in one])
    assert np.array_equal(path, np.array([w.target.position_m for w in again]))
    assert not np.allclose(path, np.array([w.target.position_m for w in other]))
    clean = play({"rate_hz": 30.0})
    assert [w.doing for w in one] == [w.doing for w in clean]


def test_no_stream_makes_the_target_leap():
    setpoints = play(ALL | {"max_speed_m_s": 0.4, "max_acceleration_m_s2": 2.0})
    velocity = np.diff([w.target.position_m for w in setpoints], axis=0) / DT
    assert np.linalg.norm(velocity, axis=1).max() <= 0.4 * 1.001
    change = np.linalg.norm(np.diff(velocity, axis=0), axis=1) / DT
    assert change.max() <= 3.001 * 2.0


def test_a_gap_has_an_order():
    with pytest.raises(ValueError, match="the shortest and the longest gap"):
        scenario.Stream(gap_s=(0.5, 0.1))
