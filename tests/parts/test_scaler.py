"""The speed scaler in front of a plain controller: what is kept with it, and is not without it."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from tests.parts import scenes
from workcell import InputError, PairWatch, SpeedScaler

PERIOD_S, T_MIN_S = 0.01, 0.5


def drive(*, scaled: bool) -> tuple[np.ndarray, np.ndarray]:
    """A cart sent at the wall at 1 m/s for 3 s: distances and times to collision, tick by tick."""
    watch = PairWatch(scenes.slide(), [("ball", "wall")])
    data = mujoco.MjData(watch.model)
    scaler = SpeedScaler(watch, [0], t_min_s=T_MIN_S, period_s=PERIOD_S, acceleration_limit=[5.0])
    rows = []
    for _ in range(300):
        data.qvel[0] = scaler.scale(data, [1.0]).velocity[0] if scaled else 1.0
        times = watch.times(data)
        rows.append((times.distance_m[0], times.ttc_s[0]))
        data.qpos[0] += data.qvel[0] * PERIOD_S
    return tuple(np.array(rows).T)


def test_the_time_to_collision_is_held_and_the_distance_decays_with_it():
    distance_m, ttc_s = drive(scaled=True)
    assert ttc_s.min() > T_MIN_S * 0.999
    assert (distance_m > 0).all()
    late = distance_m[-100:]
    assert -PERIOD_S / np.diff(np.log(late)) == pytest.approx(np.full(99, T_MIN_S), rel=0.02)
    assert drive(scaled=False)[0].min() < -0.1


def test_what_others_do_counts():
    """The second ball comes on; where standing is not enough, what is missing is said."""
    watch = PairWatch(scenes.slide(), [("ball", "second")])
    data = mujoco.MjData(watch.model)
    data.qpos[0] = 0.2
    wanted, others = [1.0], [0.0, 1.0]

    def bound(**options):
        scaler = SpeedScaler(watch, [0], t_min_s=1.0, period_s=PERIOD_S)
        return scaler.scale(data, wanted, **options).bound

    assert bound().factor > bound(others=[0.0, 0.2]).factor > 0.0
    coming = bound(others=others)
    assert coming.factor == 0.0
    near = watch.look(data)
    missing = -(near.distance_m[0] + near.jacobian[0, 1])
    assert coming.shortfall_m_s == pytest.approx(missing)
    assert bound(others=[9.0, 0.0]).factor == bound().factor, "its own part is not read"


def test_the_factor_rises_slowly_and_starts_anew_after_a_reset():
    watch = PairWatch(scenes.slide(), [("ball", "wall")])
    data = mujoco.MjData(watch.model)
    scaler = SpeedScaler(watch, [0], t_min_s=0.1, period_s=0.01, rise_time_s=0.1)
    factors = [scaler.scale(data, [0.1]).choice.factor for _ in range(12)]
    assert factors == pytest.approx([min(1.0, 0.1 * k) for k in range(1, 13)])
    scaler.reset()
    assert scaler.scale(data, [0.1]).choice.limiter == "rise"


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"t_min_s": 0.0}, "t_min_s"),
        ({"t_min_s": float("nan")}, "t_min_s"),
        ({"t_min_s": True}, "t_min_s"),
        ({"period_s": -0.01}, "period_s"),
        ({"standoff_m": float("inf")}, "standoff_m"),
        ({"rise_time_s": 0.0}, "rise_time_s"),
        ({"acceleration_limit": [1.0, 2.0]}, "acceleration_limit"),
        ({"acceleration_limit": [0.0]}, "acceleration_limit[0]"),
        ({"dofs": [2]}, "dofs"),
        ({"dofs": [0, 0]}, "dofs"),
        ({"dofs": [0.5]}, "dofs"),
        ({"dofs": []}, "dofs"),
    ],
)
def test_settings_out_of_range_are_refused_by_name(change, word):
    watch = PairWatch(scenes.slide(), [("ball", "wall")])
    settings = {"dofs": [0], "t_min_s": 1.0, "period_s": 0.01} | change
    with pytest.raises(InputError) as caught:
        SpeedScaler(watch, settings.pop("dofs"), **settings)
    assert str(caught.value).startswith(word)
    assert "allowed is" in str(caught.value) or "allowed are" in str(caught.value)


@pytest.mark.parametrize("wanted", [[1.0, 2.0], [float("nan")], 1.0])
def test_a_velocity_of_another_shape_or_without_a_value_is_refused(wanted):
    watch = PairWatch(scenes.slide(), [("ball", "wall")])
    scaler = SpeedScaler(watch, [0], t_min_s=1.0, period_s=0.01)
    with pytest.raises(InputError, match="wanted"):
        scaler.scale(mujoco.MjData(watch.model), wanted)
