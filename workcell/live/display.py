"""Whether a window can be opened here, found out before MuJoCo ends the process where it cannot."""

from __future__ import annotations

import os
import subprocess
import sys

import mujoco.viewer

from workcell.errors import InputError

PROBE_S = 20.0
"""Longest wait for a display to answer."""


def require_display() -> None:
    """Refuse where no window can be opened; without this MuJoCo ends the process.

    Raises:
        InputError: there is no display, or on macOS the program was not started by `mjpython`.
    """
    page = "or leave --window away: the page in a browser needs no display"
    if sys.platform == "darwin" and not hasattr(mujoco.viewer, "_MJPYTHON"):
        raise InputError("--window: cannot be probed with this version of MuJoCo; " + page)
    if sys.platform == "darwin" and mujoco.viewer._MJPYTHON is None:
        raise InputError(
            f"--window: on macOS the window needs mjpython: mjpython -m workcell teleop ... --window; {page}"
        )
    # In a process of its own: a display that does not answer, or a driver that crashes, ends only that.
    probe = (
        "import glfw, sys; ok = glfw.init(); glfw.window_hint(glfw.VISIBLE, 0); "
        "w = glfw.create_window(64, 64, 'probe', None, None) if ok else None; "
        "sys.exit(0 if w else 3)"
    )
    try:
        done = subprocess.run(
            [sys.executable, "-W", "ignore", "-c", probe], capture_output=True, timeout=PROBE_S
        )
        found = done.returncode == 0
    except subprocess.TimeoutExpired:
        found = False
    if not found:
        display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        named = f"the display '{display}' cannot be used" if display else "there is no display"
        raise InputError(
            f"--window: {named} (DISPLAY, WAYLAND_DISPLAY); on macOS start with mjpython; {page}"
        )
