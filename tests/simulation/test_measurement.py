"""What reaches the controller: late by whole ticks, noisy by the asked amount, with gaps that hold."""

from __future__ import annotations

import numpy as np
import pytest

from workcell.scenario import Simulation
from workcell.simulation.measurement import Measurement


def samples(ticks: int, **disturbance: float) -> tuple[np.ndarray, np.ndarray]:
    """Positions and velocities delivered of a truth that counts ticks, (ticks, 3) each."""
    measurement = Measurement(Simulation.model_validate(disturbance))
    read = [measurement.read(np.full(3, k), np.full(3, -k)) for k in map(float, range(ticks))]
    return np.array([q for q, _ in read]), np.array([v for _, v in read])


def test_undisturbed_it_is_the_truth():
    qpos, qvel = samples(20)
    assert np.array_equal(qpos, np.repeat(np.arange(20.0)[:, None], 3, axis=1))
    assert np.array_equal(qvel, -qpos)


@pytest.mark.parametrize("latency", [1, 7])
def test_latency_shows_the_state_so_many_ticks_ago(latency: int):
    qpos, _ = samples(20, latency_ticks=latency)
    assert np.array_equal(qpos[:, 0], np.maximum(np.arange(20.0) - latency, 0.0))


def test_noise_has_the_asked_size_and_depends_on_the_seed_alone():
    asked = {"position_noise_rad": 1e-3, "velocity_noise_rad_s": 5e-2, "seed": 3}
    qpos, qvel = samples(4000, **asked)
    ticks = np.arange(4000.0)[:, None]
    # 12000 draws: their scatter is known to 0.65 % (one sigma); 3 % is more than four of them.
    assert np.std(qpos - ticks) == pytest.approx(1e-3, rel=0.03)
    assert np.std(qvel + ticks) == pytest.approx(5e-2, rel=0.03)
    assert np.array_equal(samples(4000, **asked)[0], qpos)
    assert not np.array_equal(samples(4000, **{**asked, "seed": 4})[0], qpos)


def test_a_lost_sample_leaves_the_one_before():
    qpos, _ = samples(4000, dropped_fraction=0.2, seed=1)
    fresh = qpos[:, 0] == np.arange(4000.0)
    assert fresh[0]
    assert np.mean(~fresh) == pytest.approx(0.2, abs=0.025)  # four sigma of 4000 draws
    # What is held is the newest that arrived, never an older one.
    newest = np.maximum.accumulate(np.where(fresh, np.arange(4000.0), 0.0))
    assert np.array_equal(qpos[:, 0], newest)
    # Gaps have a stream of their own: noise does not move them.
    noisy, _ = samples(4000, dropped_fraction=0.2, seed=1, position_noise_rad=1e-9)
    assert np.array_equal(np.round(noisy[:, 0]), newest)
