"""The controls of the live page: its actions, keys and buttons, and what a message of its script means."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from workcell.live.devices import (
    KEY_SPEED_M_S,
    KEY_TURN_RAD_S,
    PAGE_MOVES,
    PAGE_TURNS,
    SLOW_SHARE,
    DeviceInput,
)

ACTIONS: dict[str, tuple[str, str, str, str]] = {
    "start": ("Start / pause", "Space", "Space", "start after a count of three; pause and go on"),
    "reset": (
        "Reset",
        "Backspace",
        "Backspace",
        "end this run and begin it anew, in a folder of its own",
    ),
    "quit": ("End", "9", "Digit9", "end the session and show how it went"),
    "criterion": ("Criterion", "8", "Digit8", "next criterion"),
    "t_min_down": ("t_min –", "6", "Digit6", "t_min down by 0.1 s"),
    "t_min_up": ("t_min +", "7", "Digit7", "t_min up by 0.1 s"),
    "left": ("From left", "1", "Digit1", "have things presented from the left"),
    "above": ("From above", "2", "Digit2", "have things presented from above"),
    "right": ("From right", "3", "Digit3", "have things presented from the right"),
    "record": ("Take", "R", "KeyR", "begin or end a take, kept as a recording of its own"),
    "release": ("Go on", "0", "Digit0", "let arms go on that the final check has stopped"),
    "follow": ("Follow tool", "F", "KeyF", "the camera goes with the tool"),
}
"""Action -> label, key as written, its code in a browser, what it does."""
_MORE_KEYS = (
    ("arrows", f"move right, left, away, near at {KEY_SPEED_M_S:g} m/s, as the picture shows it"),
    ("PgUp PgDn", "move up, down"),
    ("I K, U O, J L", f"turn about right, away, up at {KEY_TURN_RAD_S:g} rad/s"),
    ("Shift", f"{SLOW_SHARE:g} of these speeds"),
    ("C", "hold the clutch open"),
    ("M", "sound"),
)
JOGS = (
    ("PageUp", "up"), ("ArrowUp", "away"), ("PageDown", "down"),
    ("ArrowLeft", "left"), ("ArrowDown", "near"), ("ArrowRight", "right"),
    ("KeyI", "tip away"), ("KeyU", "roll left"), ("KeyJ", "turn left"),
    ("KeyK", "tip near"), ("KeyO", "roll right"), ("KeyL", "turn right"),
)  # fmt: skip
"""Code -> label of the buttons that move as long as they are held."""

ON_THE_PAGE: dict[str, Any] = {
    "jogs": JOGS,
    "held": [*PAGE_MOVES, *PAGE_TURNS],
    "presses": {code: name for name, (_, _, code, _) in ACTIONS.items()} | {"KeyM": "sound"},
    "keys": [*_MORE_KEYS, *((key, words) for _, key, _, words in ACTIONS.values())],
    "actions": [
        {"action": name, "label": label, "key": key, "words": words}
        for name, (label, key, _, words) in ACTIONS.items()
    ],
}
"""What the page's script is told of all this."""


@dataclass
class Held:
    """What the driver holds, as last told."""

    codes: frozenset[str] = frozenset()
    slow: bool = False
    axes: np.ndarray = field(default_factory=lambda: np.zeros(6))
    told_s: float = -math.inf


def held_in(message: dict[str, Any]) -> Held:
    """What a message says is held; what it says wrongly is not held."""
    codes = message.get("held")
    known = [code for code in codes if isinstance(code, str)] if isinstance(codes, list) else []
    return Held(
        codes=frozenset(known) & (PAGE_MOVES.keys() | PAGE_TURNS.keys()),
        slow=bool(message.get("slow")),
        axes=_axes(message.get("axes")),
        told_s=time.monotonic(),
    )


def ask(asked: DeviceInput, action: str) -> None:
    """Add one press to what was asked for; an unknown action adds nothing."""
    if action == "reset":
        asked.reset = True
    elif action == "quit":
        asked.quit = True
    elif action == "release":
        asked.release = True
    elif action == "criterion":
        asked.criterion_steps += 1
    elif action == "record":
        asked.record_steps += 1
    elif action in ("t_min_down", "t_min_up"):
        asked.t_min_steps += 1 if action == "t_min_up" else -1
    elif action in ("left", "right", "above"):
        asked.entry = action


def _axes(told: Any) -> np.ndarray:
    """Six axes in [-1, 1]; zeros where what was told is nothing of the kind."""
    if not isinstance(told, list) or len(told) != 6:
        return np.zeros(6)
    if not all(isinstance(v, (int, float)) and math.isfinite(v) for v in told):
        return np.zeros(6)
    return np.clip(np.array(told, dtype=float), -1.0, 1.0)
