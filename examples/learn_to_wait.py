"""A nurse that learns to wait where the surgeon works: a linear policy by the cross-entropy method, in minutes.

Every round tries policies on the same variations of the scenario and keeps the best. Writes the curve into `learned.csv`.
"""

import sys

import numpy as np

from workcell.envs import make

FASTER = ("check.enabled=false", "simulation.plant=kinematic", "simulation.period_s=0.02")
env = make(scenario="planar_crossing", vary=True, time_limit_s=10.0, overrides=FASTER)
SEEN = ("goal_m", "others_m", "others_m_s", "nearest_m", "soonest_per_s")


def score(weights: np.ndarray, seed: int, episodes: int) -> float:
    """Mean return; the twist in the plane is linear in what is seen."""
    env.physics.episodes.seed(seed)
    returns = np.zeros(episodes)
    for episode in range(episodes):
        step = env.reset()
        while not step.last():
            seen = np.concatenate([[1.0], *(step.observation[name] for name in SEEN)])
            x, y, turn = np.tanh(weights.reshape(3, -1) @ seen)
            step = env.step(env.action_spec().maximum * [x, y, 0, 0, 0, turn])
            returns[episode] += step.reward
    return returns.mean()


chance, mean, spread, curve = np.random.default_rng(0), np.zeros(36), np.ones(36), []
for number in range(int(sys.argv[1]) if len(sys.argv) > 1 else 12):
    tried = mean + spread * chance.standard_normal((16, 36))
    scores = np.array([score(weights, number, 2) for weights in tried])
    best = tried[scores.argsort()[-4:]]
    mean, spread = best.mean(axis=0), best.std(axis=0) + 0.05
    curve.append((scores.mean(), scores.max()))
print(f"untrained {score(np.zeros(36), 999, 6):.2f}, trained {score(mean, 999, 6):.2f}")
np.savetxt("learned.csv", curve, header="mean return of all, of the best")
