"""Keys, sticks and gamepads -> how far a target is moved and turned, and what else is asked for.

A key that is held moves the target at a constant speed for as long as it is held. Both surfaces, the
page and the window, come here with their own names for keys; what the keys do is the same.
"""

from __future__ import annotations

import queue
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workcell.errors import InputError
from workcell.extras import need
from workcell.scenario import Entry

T_MIN_STEP_S = 0.1
KEY_SPEED_M_S = 0.1
KEY_TURN_RAD_S = 0.5
"""A key that is held moves the target at this speed; chosen slow enough to stop within a centimetre by eye."""
SLOW_SHARE = 0.25
"""With Shift a key moves at this share of its speed."""
GAMEPAD_SPEED_M_S = 0.25
GAMEPAD_TURN_RAD_S = 0.8
"""At full deflection; chosen below the caps of the live operator, so that the stick has no lag."""
DEAD_ZONE = 0.12
"""Deflection below which a stick counts as released: worn sticks rest at up to a tenth."""

_RIGHT, _LEFT, _DOWN, _UP, _PAGE_UP, _PAGE_DOWN = 262, 263, 264, 265, 266, 267
_KEYPAD = {digit: 320 + digit for digit in range(10)}
_LEFT_SHIFT, _RIGHT_SHIFT = 340, 344
"""GLFW's codes."""

Axis = tuple[float, float, float]
MOVES: dict[int, Axis] = {
    _RIGHT: (1, 0, 0),
    _LEFT: (-1, 0, 0),
    _UP: (0, 1, 0),
    _DOWN: (0, -1, 0),
    _PAGE_UP: (0, 0, 1),
    _PAGE_DOWN: (0, 0, -1),
}
"""Key of the window -> direction in the world."""
TURNS: dict[int, Axis] = {
    _KEYPAD[6]: (1, 0, 0),
    _KEYPAD[4]: (-1, 0, 0),
    _KEYPAD[8]: (0, 1, 0),
    _KEYPAD[2]: (0, -1, 0),
    _KEYPAD[9]: (0, 0, 1),
    _KEYPAD[7]: (0, 0, -1),
}
"""Key of the window -> axis of the world."""
ENTRIES: dict[int, Entry] = {_KEYPAD[1]: "left", _KEYPAD[3]: "right", _KEYPAD[5]: "above"}
"""Key of the window -> side from which what is on its way is to be presented."""
_T_MIN_DOWN, _T_MIN_UP, _CRITERION, _QUIT, _RELEASE = (ord(digit) for digit in "67890")

PAGE_MOVES: dict[str, Axis] = {
    "ArrowRight": (1, 0, 0),
    "ArrowLeft": (-1, 0, 0),
    "ArrowUp": (0, 1, 0),
    "ArrowDown": (0, -1, 0),
    "PageUp": (0, 0, 1),
    "PageDown": (0, 0, -1),
}
"""Key of the page -> direction as the picture shows it: right, away, up."""
PAGE_TURNS: dict[str, Axis] = {
    "KeyK": (1, 0, 0),
    "KeyI": (-1, 0, 0),
    "KeyO": (0, 1, 0),
    "KeyU": (0, -1, 0),
    "KeyJ": (0, 0, 1),
    "KeyL": (0, 0, -1),
}
"""Key of the page -> axis as the picture shows it."""


@dataclass
class DeviceInput:
    """What was asked for since it was last asked."""

    way_m: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    """(3,) translation in the world."""
    turn_rad: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    """(3,) rotation vector in the world."""
    t_min_steps: int = 0
    criterion_steps: int = 0
    entry: Entry | None = None
    """The side asked for last; None if none was."""
    release: bool = False
    """Whether arms that the final check has stopped may go on."""
    record_steps: int = 0
    """How often the recording of a take was begun or ended."""
    reset: bool = False
    """Whether the run is to end and start over."""
    quit: bool = False

    def and_then(self, later: DeviceInput) -> DeviceInput:
        """Both together: the ways and turns of a frame are small, so their order does not matter."""
        return DeviceInput(
            self.way_m + later.way_m,
            self.turn_rad + later.turn_rad,
            self.t_min_steps + later.t_min_steps,
            self.criterion_steps + later.criterion_steps,
            later.entry or self.entry,
            self.release or later.release,
            self.record_steps + later.record_steps,
            self.reset or later.reset,
            self.quit or later.quit,
        )


def key_motion(
    moves: Collection[Axis], turns: Collection[Axis], passed_s: float, *, slow: bool = False
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Translation and rotation vector of keys that were held for some time.

    Keys that are held together move along the diagonal, no faster than one alone; opposite ones cancel.
    """
    share = passed_s * (SLOW_SHARE if slow else 1.0)
    return KEY_SPEED_M_S * share * _direction(moves), KEY_TURN_RAD_S * share * _direction(turns)


def _direction(axes: Collection[Axis]) -> NDArray[np.float64]:
    total = np.sum(list(axes), axis=0, dtype=float) if axes else np.zeros(3)
    return total / max(1.0, float(np.linalg.norm(total)))


def is_ours(key: int) -> bool:
    """Whether a key of the window drives, so that the viewer is not to act on it."""
    ours = {_T_MIN_DOWN, _T_MIN_UP, _CRITERION, _QUIT, _RELEASE}
    return key in MOVES or key in TURNS or key in ENTRIES or key in ours


class WindowKeys:
    """Collects what is pressed in MuJoCo's window, sees what is held there, and reads the gamepad.

    Args:
        gamepad: Whether to open the first gamepad.
        held: Says which of some keys are held now.

    Raises:
        InputError: a gamepad is wanted and there is none, or pygame is not installed.
    """

    def __init__(self, held: Callable[[Collection[int]], set[int]], *, gamepad: bool = False):
        self._held = held
        self._pressed: queue.SimpleQueue[int] = queue.SimpleQueue()
        self._pad = _open_gamepad() if gamepad else None

    def press(self, key: int) -> None:
        """A key has gone down; may be called from any thread."""
        self._pressed.put(key)

    def take(self, passed_s: float) -> DeviceInput:
        """Everything since the last call, `passed_s` ago."""
        asked = DeviceInput()
        down = self._held({*MOVES, *TURNS, _LEFT_SHIFT, _RIGHT_SHIFT})
        asked.way_m, asked.turn_rad = key_motion(
            [MOVES[key] for key in down & MOVES.keys()],
            [TURNS[key] for key in down & TURNS.keys()],
            passed_s,
            slow=bool(down & {_LEFT_SHIFT, _RIGHT_SHIFT}),
        )
        while not self._pressed.empty():
            key = self._pressed.get()
            if key in ENTRIES:
                asked.entry = ENTRIES[key]
            elif key == _CRITERION:
                asked.criterion_steps += 1
            elif key == _RELEASE:
                asked.release = True
            elif key == _QUIT:
                asked.quit = True
            elif key in (_T_MIN_DOWN, _T_MIN_UP):
                asked.t_min_steps += 1 if key == _T_MIN_UP else -1
        if self._pad is not None:
            way, turn = stick_motion(read_axes(self._pad), passed_s)
            asked.way_m, asked.turn_rad = asked.way_m + way, asked.turn_rad + turn
        return asked


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
