"""The keyboard of MuJoCo's window: what is held, and what the viewer is not to see."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Collection
from typing import Any

import glfw

from workcell.live.devices import is_ours

_KEY_EVENT = ctypes.CFUNCTYPE(
    None, ctypes.c_void_p, ctypes.c_int, ctypes.c_int, ctypes.c_int, ctypes.c_int
)


class Keyboard:
    """The keys of the viewer's window, held ones included.

    MuJoCo's callback tells presses only, and MuJoCo acts on many of the keys itself. In the callback its
    window is the current one: from there on the window's own key events come here first, and those
    that drive the markers go no further.
    """

    def __init__(self) -> None:
        self._window: Any = None
        self._kept: Any = None
        """The callback, which must live as long as the window."""

    def attach(self, press: Callable[[int], None]) -> bool:
        """Take the keyboard of the current window, once; True if this call did it."""
        if self._window is not None:
            return False
        window = glfw.get_current_context()
        if not window:
            return False
        self._window = window
        before = None

        @_KEY_EVENT
        def event(window: Any, key: int, code: int, action: int, modifiers: int) -> None:
            if not is_ours(key):
                if before:
                    before(window, key, code, action, modifiers)
            elif action == glfw.PRESS:
                press(key)

        # Not by way of the package's own function, which forgets a callback that came from C.
        exchange = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, _KEY_EVENT)(
            ("glfwSetKeyCallback", glfw.library.glfw)
        )
        address = exchange(ctypes.cast(window, ctypes.c_void_p), event)
        before = _KEY_EVENT(address) if address else None
        self._kept = event
        return True

    def held(self, keys: Collection[int]) -> set[int]:
        """Which of some keys are down now."""
        if self._window is None:
            return set()
        return {key for key in keys if glfw.get_key(self._window, key) == glfw.PRESS}
