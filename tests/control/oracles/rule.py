"""Times, criteria, the rule and what it leaves of a velocity, for all pairs at once (theory: sections 4 to 6)."""

from __future__ import annotations

import numpy as np

GRAZING = 1e-12
FLOOR_M = 1e-3
STOP_MARGIN_RAD, STOP_PUSH_RAD_S = 0.2, 1.0
TASK_SLACK_M_S, AT_REST_M_S = 1e-5, 1e-4
MUST_YIELD_M_S, MUST_YIELD_MEETING_M_S = 1e-3, 0.03


def first_order(distance, rate, standoff=0.0) -> np.ndarray:
    """Reciprocal times of first order."""
    gap = distance - standoff
    kappa = np.zeros(gap.shape)
    np.divide(-rate, gap, out=kappa, where=(rate < 0.0) & (gap > 0.0))
    return _with_contact(kappa, distance, gap, rate < 0.0)


def second_order(distance, rate, accel, standoff=0.0) -> np.ndarray:
    """Reciprocal times of second order, both terms of the discriminant divided by the larger one's size."""
    gap = distance - standoff
    ahead = gap > 0.0
    reach = np.where(ahead, gap, 1.0)
    curvature = np.sqrt(np.abs(accel)) * np.sqrt(reach)
    size = np.maximum(np.abs(rate), curvature)
    moving = ahead & (size > 0.0)
    size = np.where(moving, size, 1.0)
    speed = rate / size
    discriminant = speed**2 - 2.0 * np.sign(accel) * (curvature / size) ** 2
    root = np.sqrt(np.maximum(discriminant, 0.0))
    closing_root = size * (root - speed) / (2.0 * reach)
    opening_root = np.divide(
        -accel, size * (root + speed), out=np.zeros(gap.shape), where=moving & (speed > 0.0)
    )
    kappa = np.where(speed > 0.0, opening_root, closing_root)
    kappa = np.where(moving & (discriminant >= -GRAZING), np.maximum(kappa, 0.0), 0.0)
    return _with_contact(kappa, distance, gap, (rate < 0.0) | ((rate == 0.0) & (accel < 0.0)))


def _with_contact(kappa, distance, gap, closing) -> np.ndarray:
    return np.where((distance <= 0.0) | ((gap <= 0.0) & closing), np.inf, kappa)


def smallest(kappa) -> tuple[float, int]:
    """The shortest time and its pair."""
    if not len(kappa) or kappa.max() == 0.0:
        return np.inf, -1
    pair = int(kappa.argmax())
    ttc = float(1.0 / kappa[pair])
    return ttc, pair if ttc < np.inf else -1


def means(distance, rate, *, approaching: bool) -> tuple[float, float]:
    """ARTC and ARMD."""
    floored = np.maximum(distance, FLOOR_M)
    closing = np.maximum(0.0, -rate) if approaching else -rate
    return float(np.mean(closing / floored)), float(np.mean(1.0 / floored))


def objective(name, distance, rate, rows, other) -> tuple[np.ndarray, np.ndarray]:
    """H and c of a criterion."""
    pairs, n = rows.shape
    floored = np.maximum(distance, FLOOR_M)[:, None]
    if name == "artc":
        return np.zeros((n, n)), -(rows / floored).sum(axis=0) / pairs
    if name == "armd":
        return np.zeros((n, n)), -(rows / floored**2).sum(axis=0) / pairs
    if name == "artc_held":
        weight = (0.8 + 8.0 * np.maximum(0.0, -rate) / floored[:, 0]) / floored[:, 0]
        return np.zeros((n, n)), -(weight @ rows) / pairs
    if name == "artc_approaching":
        scaled = np.where((rate < 0.0)[:, None], rows / floored, 0.0)
        return scaled.T @ scaled / pairs, scaled.T @ (other / floored[:, 0]) / pairs
    return np.zeros((n, n)), np.zeros(n)


def push_from_stops(q, lower, upper, weight) -> np.ndarray:
    """What is added to c."""
    below = np.maximum(STOP_MARGIN_RAD - (q - lower), 0.0) / STOP_MARGIN_RAD
    above = np.maximum(STOP_MARGIN_RAD - (upper - q), 0.0) / STOP_MARGIN_RAD
    return -STOP_PUSH_RAD_S * (below**2 - above**2) / weight


def pairwise_factor(distance, own, other, t_min, standoff=0.0) -> tuple:
    """Factor, pair, factor before clamping, shortfall, its pair."""
    if not len(distance):
        return 1.0, -1, np.inf, 0.0, -1
    allowance = (distance - standoff) / t_min + other
    closing = own < 0.0
    required = np.full(distance.shape, np.inf)
    np.divide(allowance, -own, out=required, where=closing)
    pair = int(required.argmin())
    least = float(required[pair])
    factor = 0.0 if least <= 0.0 else min(least, 1.0)
    margin = np.where(closing & (allowance >= 0.0), 0.0, allowance + factor * own)
    worst = int(margin.argmin())
    short = max(0.0, -float(margin[worst]))
    return factor, pair if least < 1.0 else -1, least, short, worst if short > 0.0 else -1


def acceleration_interval(previous, wanted, limit, period) -> tuple[float, float, bool]:
    """Smallest and largest factor and whether there is one; else the least violating one."""
    change = limit * period
    still = wanted == 0.0
    ends = np.divide(
        np.stack([previous - change, previous + change]), wanted,
        out=np.array([[-np.inf], [np.inf]]) * np.ones(len(wanted)), where=~still,
    )  # fmt: skip
    lowest, highest = max(0.0, ends.min(axis=0).max()), min(1.0, ends.max(axis=0).min())
    if lowest <= highest and (np.abs(previous[still]) <= change[still]).all():
        return lowest, highest, True
    least = _least_violation(previous / change, wanted / change)
    return least, least, False


def _least_violation(previous, wanted) -> float:
    """The s in [0, 1] that minimises max |s wanted - previous|, among all crossings of its lines."""
    slope = np.concatenate([wanted, -wanted])
    offset = np.concatenate([-previous, previous])
    difference = slope[:, None] - slope
    crosses = difference != 0.0
    crossings = (offset - offset[:, None])[crosses] / difference[crosses]
    candidates = np.concatenate([[0.0, 1.0], crossings[(crossings > 0.0) & (crossings < 1.0)]])
    worst = np.abs(np.outer(candidates, wanted) - previous).max(axis=1)
    return float(candidates[worst <= worst.min() * (1.0 + 1e-12)].min())


def joint_box(q, arm, previous, dt_s) -> tuple[np.ndarray, np.ndarray]:
    """(n,) smallest and largest joint velocity of an arm."""
    a, fastest = arm.acceleration_limit_rad_s2, arm.velocity_limit_rad_s

    def towards(distance):
        # So many whole steps of a dt, and a part f of another: the way is dt² a (N (N + 1) / 2 + f (N + 1)).
        quanta = np.minimum(np.maximum(distance, 0.0) / (a * dt_s**2), 1e15)
        whole = np.floor(np.sqrt(0.25 + 2.0 * quanta) - 0.5)
        part = (quanta - whole * (whole + 1.0) / 2.0) / (whole + 1.0)
        speed = a * dt_s * (whole + np.clip(part, 0.0, 1.0))
        back = np.maximum(distance / dt_s, -fastest)
        return np.minimum(np.where(distance < 0.0, back, speed), fastest)

    low, high = -towards(q - arm.lower_rad), towards(arm.upper_rad - q)
    step = a * dt_s
    return (
        np.minimum(np.maximum(low, previous - step), high),
        np.maximum(np.minimum(high, previous + step), low),
    )
