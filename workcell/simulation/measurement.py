"""What the controller is told of the plant's state: late, noisy and with gaps.

Comes in: the true joint positions and velocities of a tick. Goes out: the sample that reaches the
controller at that tick. A sample is taken with white noise, arrives `latency_ticks` later, and is
lost with probability `dropped_fraction`; in place of a lost one the newest that has arrived counts.
With all of `[simulation]`'s disturbances at zero, the truth passes unchanged.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from workcell.scenario import Simulation

Sample = tuple[NDArray[np.float64], NDArray[np.float64]]

_STREAM = 0x5E2503
"""Keeps the noise apart from whatever else draws from the scenario's seed; any fixed number does."""


class Measurement:
    """Stands between the plant and the controller for one run.

    Args:
        simulation: The disturbances and the seed that fixes every draw.
    """

    def __init__(self, simulation: Simulation):
        self._settings = simulation
        noise, gaps = np.random.SeedSequence([simulation.seed, _STREAM]).spawn(2)
        # Two streams, so that a change of one disturbance leaves the draws of the other alone.
        self._noise = np.random.default_rng(noise)
        self._gaps = np.random.default_rng(gaps)
        self._under_way: deque[Sample] = deque(maxlen=simulation.latency_ticks + 1)
        self._arrived: Sample | None = None
        self._undisturbed = not (
            simulation.latency_ticks
            or simulation.position_noise_rad
            or simulation.velocity_noise_rad_s
            or simulation.dropped_fraction
        )

    def read(self, qpos: NDArray[np.float64], qvel: NDArray[np.float64]) -> Sample:
        """One tick: the true state in, the sample the controller gets out.

        Args:
            qpos: (nq,) true positions. Noise is added entry by entry, as on hinges and slides.
            qvel: (nv,) true velocities.

        Returns:
            (nq,) and (nv,) arrays of its own. Until the first sample has arrived, the controller
            has the state of the first tick: arms are known before they are switched on.
        """
        settings = self._settings
        if self._undisturbed:
            return np.array(qpos), np.array(qvel)
        self._under_way.append(
            (
                qpos + settings.position_noise_rad * self._noise.standard_normal(len(qpos)),
                qvel + settings.velocity_noise_rad_s * self._noise.standard_normal(len(qvel)),
            )
        )
        lost = self._gaps.random() < settings.dropped_fraction
        if self._arrived is None or not lost:
            # The queue holds latency_ticks + 1 samples: the oldest is the one that arrives now.
            self._arrived = self._under_way[0]
        return self._arrived
