"""Reference governor: an input that may leap -> a target that never does.

Speed and acceleration of what comes out stay below caps, for translation and rotation apart. An
input that keeps the caps itself passes unchanged, to the last bit, which is what lets a recorded
run replay to the same trace. Otherwise the target closes the distance e to its input at

    v = v_in + e · min(GAIN, sqrt(a |e|) / |e|),   |v| <= v_max,   |Δv| <= a dt,

the square root being the speed from which braking at half the cap still fits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workcell import scenario
from workcell.motion.orientation import rotation_between, turned
from workcell.motion.path import Target, length, standing
from workcell.motion.setpoint import CATCHING_UP, VALID

GAIN_PER_S = 10.0
"""Rate at which a small distance is closed; chosen as the controller's own default task gain."""
CAUGHT_UP_M = 1e-3
CAUGHT_UP_RAD = 1e-2
"""After a fault the target counts as back on its input within these, beyond what it always lags behind a moving one;
chosen as what a hand does not feel."""
_ROUNDING = 1.0 + 1e-6
"""A cap kept to the last bit must not read as broken."""


@dataclass(frozen=True)
class Caps:
    """What a target may do."""

    speed_m_s: float
    acceleration_m_s2: float
    turn_rad_s: float
    turn_rad_s2: float

    @classmethod
    def of(cls, settings: scenario.Recording | scenario.Live | scenario.Stream) -> Caps:
        """Those of an operator whose input may leap."""
        return cls(
            settings.max_speed_m_s,
            settings.max_acceleration_m_s2,
            settings.max_turn_rad_s,
            settings.max_turn_rad_s2,
        )


class ReferenceGovernor:
    """Slews a target after its input.

    Args:
        caps: Largest speeds and accelerations.
        position_m, wxyz: Pose at the start, at rest.
        period_s: Time between two calls.
    """

    def __init__(
        self,
        caps: Caps,
        position_m: NDArray[np.float64],
        wxyz: NDArray[np.float64],
        *,
        period_s: float,
    ):
        self._caps = caps
        self._dt = period_s
        self.target = standing(position_m, wxyz)
        self._behind = False
        """Whether a fault has left the target behind its input."""

    def follow(self, wanted: Target, state: str) -> tuple[Target, str]:
        """One call a tick.

        Args:
            wanted: The input.
            state: Its state, see `workcell.motion.setpoint`.

        Returns:
            The target, and the state: `catching_up` where the input is valid again but still ahead.
        """
        target = self._next(wanted)
        if state != VALID:
            self._behind = True
        elif (
            length(wanted.position_m - target.position_m)
            < CAUGHT_UP_M + length(target.velocity_m_s) / GAIN_PER_S
            and length(rotation_between(target.wxyz, wanted.wxyz))
            < CAUGHT_UP_RAD + length(target.angular_velocity_rad_s) / GAIN_PER_S
        ):
            self._behind = False
        return target, CATCHING_UP if self._behind and state == VALID else state

    def _next(self, wanted: Target) -> Target:
        last, caps, dt = self.target, self._caps, self._dt
        away = wanted.position_m - last.position_m
        turn = rotation_between(last.wxyz, wanted.wxyz)
        passes = _keeps(
            away, wanted.velocity_m_s, last.velocity_m_s, caps.speed_m_s, caps.acceleration_m_s2, dt
        ) and _keeps(
            turn,
            wanted.angular_velocity_rad_s,
            last.angular_velocity_rad_s,
            caps.turn_rad_s,
            caps.turn_rad_s2,
            dt,
        )
        if passes:
            self.target = wanted
            return wanted
        velocity = _slew(
            away, wanted.velocity_m_s, last.velocity_m_s, caps.speed_m_s, caps.acceleration_m_s2, dt
        )
        spin = _slew(
            turn,
            wanted.angular_velocity_rad_s,
            last.angular_velocity_rad_s,
            caps.turn_rad_s,
            caps.turn_rad_s2,
            dt,
        )
        self.target = Target(
            last.position_m + dt * velocity, turned(last.wxyz, dt * spin), velocity, spin
        )
        return self.target


def _keeps(
    away: NDArray[np.float64],
    wanted: NDArray[np.float64],
    last: NDArray[np.float64],
    speed: float,
    acceleration: float,
    dt: float,
) -> bool:
    """Whether the input is where a motion within the caps could be: velocity within reach, position in keeping with it."""
    return (
        length(wanted) <= speed * _ROUNDING
        and length(wanted - last) <= acceleration * dt * _ROUNDING
        and length(away - dt * wanted) <= acceleration * dt * dt * _ROUNDING
    )


def _slew(
    away: NDArray[np.float64],
    wanted: NDArray[np.float64],
    last: NDArray[np.float64],
    speed: float,
    acceleration: float,
    dt: float,
) -> NDArray[np.float64]:
    """Velocity towards the input within both caps."""
    distance = length(away)
    # Braking is planned at half the cap, so that the other half can follow an input that moves.
    rate = GAIN_PER_S if distance == 0.0 else min(GAIN_PER_S, math.sqrt(acceleration / distance))
    velocity = _at_most(wanted + rate * away, speed)
    return _at_most(last + _at_most(velocity - last, acceleration * dt), speed)


def _at_most(vector: NDArray[np.float64], most: float) -> NDArray[np.float64]:
    norm = length(vector)
    return vector if norm <= most else vector * (most / norm)
