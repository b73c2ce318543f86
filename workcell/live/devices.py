"""Keys and gamepad -> how far a target is moved and turned, and what else is asked for.

Keys arrive one by one from the viewer's thread and are taken together once a frame. Those the
viewer uses itself (letters, digits up to 5, Space, Tab) are left to it.
"""

from __future__ import annotations

import queue
from dataclasses import dataclass, field
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from workcell.errors import InputError
from workcell.extras import need
from workcell.motion.orientation import turned
from workcell.scenario import Criterion, Entry

CRITERIA: tuple[str, ...] = get_args(Criterion)
"""In the order in which the key goes through them."""
T_MIN_STEP_S = 0.1
STEP_M = 0.01
"""A key press moves the target by this; chosen small enough to steer by, large enough to get on."""
STEP_RAD = 0.05
GAMEPAD_SPEED_M_S = 0.25
GAMEPAD_TURN_RAD_S = 0.8
"""At full deflection; chosen below the caps of the live operator, so that the stick has no lag."""
DEAD_ZONE = 0.12
"""Deflection below which a stick counts as released: worn sticks rest at up to a tenth."""

_RIGHT, _LEFT, _DOWN, _UP, _PAGE_UP, _PAGE_DOWN = 262, 263, 264, 265, 266, 267
_KEYPAD = {digit: 320 + digit for digit in range(10)}
"""GLFW's codes."""

MOVES: dict[int, tuple[float, float, float]] = {
    _RIGHT: (1, 0, 0),
    _LEFT: (-1, 0, 0),
    _UP: (0, 1, 0),
    _DOWN: (0, -1, 0),
    _PAGE_UP: (0, 0, 1),
    _PAGE_DOWN: (0, 0, -1),
}
"""Key -> direction in the world."""
TURNS: dict[int, tuple[float, float, float]] = {
    _KEYPAD[6]: (1, 0, 0),
    _KEYPAD[4]: (-1, 0, 0),
    _KEYPAD[8]: (0, 1, 0),
    _KEYPAD[2]: (0, -1, 0),
    _KEYPAD[9]: (0, 0, 1),
    _KEYPAD[7]: (0, 0, -1),
}
"""Key -> axis of the world."""
ENTRIES: dict[int, Entry] = {_KEYPAD[1]: "left", _KEYPAD[3]: "right", _KEYPAD[5]: "above"}
"""Key -> side from which what is on its way is to be presented."""
_T_MIN_DOWN, _T_MIN_UP, _CRITERION, _QUIT = ord("6"), ord("7"), ord("8"), ord("9")


@dataclass
class Steering:
    """What was asked for since the last frame."""

    way_m: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    """(3,) translation in the world."""
    turn_rad: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    """(3,) rotation vector in the world."""
    t_min_steps: int = 0
    criterion_steps: int = 0
    entry: Entry | None = None
    """The side asked for last; None if none was."""
    quit: bool = False

    def and_then(self, later: Steering) -> Steering:
        """Both together: the ways and turns of a frame are small, so their order does not matter."""
        return Steering(
            self.way_m + later.way_m,
            self.turn_rad + later.turn_rad,
            self.t_min_steps + later.t_min_steps,
            self.criterion_steps + later.criterion_steps,
            later.entry or self.entry,
            self.quit or later.quit,
        )

    def moved(
        self, position_m: NDArray[np.float64], wxyz: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """A pose after translation and rotation."""
        return position_m + self.way_m, turned(wxyz, self.turn_rad)


class Keys:
    """Collects key presses and reads the gamepad.

    Args:
        gamepad: Whether to open the first gamepad.

    Raises:
        InputError: a gamepad is wanted and there is none, or pygame is not installed.
    """

    def __init__(self, *, gamepad: bool = False):
        self._pressed: queue.SimpleQueue[int] = queue.SimpleQueue()
        self._pad = _open_gamepad() if gamepad else None

    def press(self, key: int) -> None:
        """The viewer's key callback; runs in the viewer's thread."""
        self._pressed.put(key)

    def take(self, passed_s: float) -> Steering:
        """Everything since the last call, `passed_s` ago."""
        steering = Steering()
        while not self._pressed.empty():
            key = self._pressed.get()
            if key in MOVES:
                steering.way_m += STEP_M * np.array(MOVES[key])
            elif key in TURNS:
                steering.turn_rad += STEP_RAD * np.array(TURNS[key])
            elif key in ENTRIES:
                steering.entry = ENTRIES[key]
            elif key == _CRITERION:
                steering.criterion_steps += 1
            elif key == _QUIT:
                steering.quit = True
            elif key in (_T_MIN_DOWN, _T_MIN_UP):
                steering.t_min_steps += 1 if key == _T_MIN_UP else -1
        if self._pad is not None:
            way, turn = stick_motion(read_axes(self._pad), passed_s)
            steering.way_m += way
            steering.turn_rad += turn
        return steering


def stick_motion(
    axes: NDArray[np.float64], passed_s: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Translation and rotation vector from six axes in [-1, 1]: x, y, z, and turns about them."""
    beyond = np.sign(axes) * np.maximum(np.abs(axes) - DEAD_ZONE, 0.0) / (1.0 - DEAD_ZONE)
    return GAMEPAD_SPEED_M_S * passed_s * beyond[:3], GAMEPAD_TURN_RAD_S * passed_s * beyond[3:]


def read_axes(pad: Any) -> NDArray[np.float64]:
    """(6,) axes of a gamepad: left stick x and y, right stick z, right stick and bumpers the turns.

    A 3D mouse is a joystick with six axes of its own and gives all of them directly.
    """
    import pygame

    pygame.event.pump()
    axes = [float(pad.get_axis(k)) for k in range(pad.get_numaxes())]
    if "space" in pad.get_name().lower() and len(axes) >= 6:
        x, y, z, roll, pitch, yaw = axes[:6]
        return np.array([x, -y, -z, roll, -pitch, -yaw])
    axes += [0.0] * (4 - len(axes))
    bumpers = [float(pad.get_button(k)) if pad.get_numbuttons() > k else 0.0 for k in (4, 5)]
    return np.array([axes[0], -axes[1], -axes[3], 0.0, bumpers[1] - bumpers[0], axes[2]])


def _open_gamepad() -> Any:
    pygame = need("pygame", extra="gamepad", what="--gamepad")
    pygame.init()
    pygame.joystick.init()
    if not pygame.joystick.get_count():
        raise InputError("--gamepad: there is no gamepad or 3D mouse")
    return pygame.joystick.Joystick(0)
