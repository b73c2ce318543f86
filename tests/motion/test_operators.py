"""Scripted operators and the simulated person."""

from __future__ import annotations

import numpy as np
import pytest

from workcell import scenario
from workcell.motion.operators import make_operator
from workcell.motion.operators.hand import TREMOR_HZ
from workcell.motion.operators.human import HumanOperator
from workcell.motion.orientation import rotation_between

HOME = np.array([0.4, 0.5, 0.4])
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
TURNED = (np.cos(0.3), 0.0, np.sin(0.3), 0.0)


def human(**settings):
    sites = [{"position_m": [0.4, 0.6, 0.4]}, {"position_m": [0.5, 0.6, 0.45], "wxyz": TURNED}]
    return scenario.Human.model_validate({"kind": "human", "sites": sites, **settings})


def make(settings, seed=0, name="surgeon"):
    return make_operator(settings, HOME, UPRIGHT, seed=seed, name=name)


def positions(operator, times):
    return np.array([operator.setpoint(t).target.position_m for t in times])


def test_a_person_is_the_same_for_the_same_seed_and_arm_only():
    times = np.arange(0.0, 20.0, 0.05)
    path = positions(make(human()), times)
    assert np.array_equal(path, positions(make(human()), times))
    assert not np.allclose(path, positions(make(human(), seed=1), times))
    assert not np.allclose(path, positions(make(human(), name="second"), times))


def test_a_person_moves_alike_however_often_it_is_asked():
    often, seldom = make(human()), make(human())
    for t in np.arange(0.0, 15.0, 0.002):
        often.setpoint(t)
    assert np.array_equal(
        often.setpoint(15.0).target.position_m, seldom.setpoint(15.0).target.position_m
    )


def test_a_person_starts_at_rest_where_the_tool_is():
    target = make(human()).setpoint(0.0).target
    assert np.array_equal(target.position_m, HOME)
    assert np.array_equal(target.wxyz, UPRIGHT)
    assert not target.velocity_m_s.any()


@pytest.mark.parametrize("tremor_m", [0.0, 6e-5])
def test_the_twist_of_a_person_is_the_derivative_of_the_pose(tremor_m):
    operator = make(human(tremor_m=tremor_m, withdraw_probability=0.5))
    step = 1e-6
    for t in np.arange(0.013, 12.0, 0.0917):
        before, here, after = (operator.setpoint(t + d).target for d in (-step, 0.0, step))
        velocity = (after.position_m - before.position_m) / (2 * step)
        turn = rotation_between(before.wxyz, after.wxyz) / (2 * step)
        assert here.velocity_m_s == pytest.approx(velocity, abs=1e-5)
        assert here.angular_velocity_rad_s == pytest.approx(turn, abs=1e-5)


def test_a_person_keeps_to_its_speeds_and_does_all_it_can_do():
    settings = human(tremor_m=0.0, withdraw_probability=0.4, elbow_probability=0.4)
    operator = make(settings)
    done: dict[str, float] = {}
    for t in np.arange(0.0, 120.0, 0.03):
        setpoint = operator.setpoint(t)
        speed = float(np.linalg.norm(setpoint.target.velocity_m_s))
        done[setpoint.doing] = max(done.get(setpoint.doing, 0.0), speed)
    assert set(done) == {"reach", "pause", "withdraw", "elbow_shift"}
    assert done["pause"] == done["elbow_shift"] == 0.0
    assert done["reach"] <= settings.speed_m_s
    assert settings.speed_m_s < done["withdraw"] <= settings.withdraw_speed_m_s


def test_starts_and_stops_break_a_reach_off_on_its_way():
    sites = np.array([site.position_m for site in human().sites])

    def rests_between(stop_probability):
        settings = human(tremor_m=0.0, stop_probability=stop_probability, withdraw_probability=0.0)
        operator = make(settings)
        setpoints = [operator.setpoint(t) for t in np.arange(1.0, 60.0, 0.05)]
        rests = [w.target.position_m for w in setpoints if w.doing == "pause"]
        return [p for p in rests if np.linalg.norm(sites - p, axis=1).min() > 1e-3]

    assert len(rests_between(0.0)) == 0
    assert len(rests_between(1.0)) > 10


def test_tremor_has_its_amplitude_and_its_band():
    operator = make(human(tremor_m=1e-4, start_s=40.0))
    times = np.arange(2.0, 34.0, 0.01)
    wobble = positions(operator, times) - HOME
    # Three beating lines over 32 s: the mean power is theirs up to a tenth.
    assert np.sqrt((wobble**2).mean(axis=0)) == pytest.approx(np.full(3, 1e-4), rel=0.1)
    power = (np.abs(np.fft.rfft(wobble, axis=0)) ** 2).sum(axis=1)
    frequency = np.fft.rfftfreq(len(times), 0.01)
    inside = (frequency > TREMOR_HZ[0] - 0.5) & (frequency < TREMOR_HZ[1] + 0.5)
    assert power[inside].sum() > 0.95 * power.sum()


def test_an_elbow_swing_covers_its_way_and_comes_back():
    operator = make(human(elbow_probability=1.0, elbow_shift_m=0.05))
    times = np.arange(0.0, 30.0, 0.002)
    swung = np.cumsum([operator.setpoint(t).elbow_speed_m_s * 0.002 for t in times])
    assert swung.max() == pytest.approx(0.05, rel=1e-2)
    assert swung.min() == pytest.approx(0.0, abs=1e-3)


def test_sweeps_go_back_and_forth_between_first_and_last_waypoint():
    ends = np.array([[0.1, 0.6, 0.5], [0.5, 0.6, 0.5]])
    settings = scenario.Waypoints.model_validate(
        {
            "kind": "waypoints",
            "waypoints": [{"position_m": list(p)} for p in ends],
            "speed_m_s": 0.25,
            "acceleration_m_s2": 1.0,
            "repeat": 3,
            "pause_s": 0.2,
        }
    )
    operator = make(settings)
    setpoints = [operator.setpoint(t).target for t in np.arange(0.0, 20.0, 0.01)]
    path = np.array([w.position_m for w in setpoints])
    speed = np.array([np.linalg.norm(w.velocity_m_s) for w in setpoints])
    assert path[-1] == pytest.approx(ends[0], abs=1e-6)  # there, back, there, back: 3 repeats
    # The approach is a spline through both waypoints; the sweeps after it are straight lines.
    assert speed[len(speed) // 4 :].max() == pytest.approx(0.25, rel=1e-6)
    at = [k for k in (0, 1) for p in [ends[k]] if (np.linalg.norm(path - p, axis=1) < 1e-6).any()]
    assert at == [0, 1]
    turned_round = np.sum(np.diff(np.sign(np.diff(path[:, 0]))[np.diff(path[:, 0]) != 0]) != 0)
    assert turned_round == 4  # once after the approach from the start, then once a repeat
    assert np.abs(np.diff(path, axis=0)).max() <= 0.25 * 0.01 * 1.02


def test_one_waypoint_sweeps_between_it_and_the_start():
    settings = scenario.Waypoints.model_validate(
        {"kind": "waypoints", "waypoints": [{"position_m": [0.1, 0.5, 0.4]}], "repeat": 1}
    )
    assert make(settings).setpoint(60.0).target.position_m == pytest.approx(HOME, abs=1e-9)


def test_a_person_at_a_single_site_works_on():
    settings = human(sites=[{"position_m": [0.4, 0.6, 0.4]}], stop_probability=0.0)
    operator = HumanOperator(settings, HOME, UPRIGHT, np.random.default_rng(0))
    assert operator.setpoint(30.0).target.position_m == pytest.approx([0.4, 0.6, 0.4], abs=0.11)


HOSTILE = {
    "reach_out_probability": 1.0,
    "flick_probability": 1.0,
    "reversal_probability": 1.0,
    "stop_probability": 0.0,
    "withdraw_probability": 0.0,
    "elbow_probability": 0.0,
    "pause_s": (0.1, 0.2),
    "tremor_m": 0.0,
}


def hostile(duration_s=30.0, step_s=0.002, **settings):
    operator = make(human(**HOSTILE | settings))
    return [operator.setpoint(t) for t in np.arange(0.0, duration_s, step_s)]


def test_a_hostile_person_does_all_it_can_do_within_its_peaks():
    setpoints = hostile()
    fastest: dict[str, float] = {}
    for w in setpoints:
        speed = float(np.linalg.norm(w.target.velocity_m_s))
        fastest[w.doing] = max(fastest.get(w.doing, 0.0), speed)
    assert set(fastest) == {"reach", "pause", "flick", "reversal", "reach_out"}
    assert fastest["flick"] <= 2.0
    assert 1.0 < fastest["reversal"] <= 2.0
    assert fastest["reach_out"] == pytest.approx(0.5, rel=1e-3)
    acceleration = np.diff([w.target.velocity_m_s for w in setpoints], axis=0) / 0.002
    assert np.linalg.norm(acceleration, axis=1).max() <= 15.0 * 1.01


def test_reaching_out_ends_at_its_distance_level_or_above():
    setpoints = hostile(
        flick_probability=0.0, reversal_probability=0.0, speed_m_s=1.0, acceleration_m_s2=5.0
    )
    out = [k for k, w in enumerate(setpoints) if w.doing == "reach_out"]
    ends = [k for k in out if k + 1 < len(setpoints) and setpoints[k + 1].doing != "reach_out"]
    begins = [k for k in out if setpoints[k - 1].doing != "reach_out"]
    assert len(ends) > 3
    for first, last in zip(begins, ends, strict=False):
        way = setpoints[last + 1].target.position_m - setpoints[first].target.position_m
        assert np.linalg.norm(way) == pytest.approx(0.8, abs=1e-3)
        assert way[2] >= -1e-9


def test_flicks_and_reversals_come_back_to_where_they_began():
    for doing, way in (("flick", 0.3), ("reversal", 0.05)):
        settings = {"flick_probability": 0.0, "reversal_probability": 0.0} | {
            f"{doing}_probability": 1.0,
            f"{doing}_m": way,
            "reach_out_probability": 0.0,
        }
        setpoints = hostile(**settings)
        inside = [k for k, w in enumerate(setpoints) if w.doing == doing]
        begins = [k for k in inside if setpoints[k - 1].doing != doing]
        ends = [k for k in inside if k + 1 < len(setpoints) and setpoints[k + 1].doing != doing]
        assert len(ends) > 3
        for first, last in zip(begins, ends, strict=False):
            path = np.array([w.target.position_m for w in setpoints[first - 1 : last + 2]])
            away = np.linalg.norm(path - path[0], axis=1)
            assert away.max() == pytest.approx(way, abs=2e-3)
            assert away[-1] == pytest.approx(0.0, abs=1e-6)


def test_what_is_switched_off_draws_nothing():
    """The keys of a hostile hand do not change what a person did before there were any."""
    times = np.arange(0.0, 20.0, 0.05)
    keys = {"reach_out_m": 2.0, "flick_m": 0.4, "reversal_count": 9, "fast_speed_m_s": 1.0}
    assert np.array_equal(positions(make(human()), times), positions(make(human(**keys)), times))


def test_a_hostile_motion_is_seeded():
    times = np.arange(0.0, 20.0, 0.05)
    one, again = make(human(**HOSTILE)), make(human(**HOSTILE))
    assert np.array_equal(positions(one, times), positions(again, times))
    assert not np.allclose(
        positions(make(human(**HOSTILE)), times), positions(make(human(**HOSTILE), seed=1), times)
    )
