"""The window of a live run: MuJoCo's passive viewer, drawn and read by threads of its own.

In go pictures of the plant (joint positions, text, a line between witness points), out come the
poses of the markers that mouse, keys and gamepad have moved. The control loop never waits for the
screen: a slow one shows fewer pictures. The model shown is the scene plus one marker for every live
arm, on data of its own, so that nothing done in the window can push the simulated arms.
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import mujoco.viewer
import numpy as np
from numpy.typing import NDArray

from workcell.errors import InputError
from workcell.live.devices import Keys, Steering

FRAME_S = 1 / 60
"""Time between two pictures, and between two readings of mouse and keys: screens redraw at 60 Hz."""
TEXT_S = 0.2
"""Time between two texts; chosen as fast as digits can be read."""
CLOSING_S = 5.0
"""Longest wait for the viewer to end, so that a stuck driver does not hold the run's results back."""
VIEW_DISTANCE_M = 2.2
VIEW_ANGLES_DEG = (90.0, -30.0)
"""Where the camera starts: along y, so that the arrow keys move the target as the picture shows it."""
MARKER_HALF_EXTENTS_M = (0.02, 0.02, 0.05)
MARKER_RGBA = (0.2, 0.75, 0.35, 0.6)
_WITNESS_RGBA = np.array([0.95, 0.75, 0.1, 1.0], dtype=np.float32)
_WITNESS_WIDTH = 4.0
_COSTLY_EFFECTS = (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION)
"""Effects that cost more than they show where a processor has to draw."""

Pose = tuple[NDArray[np.float64], NDArray[np.float64]]
"""(3,) position in m and (4,) unit quaternion, in the world."""


@dataclass(frozen=True)
class Picture:
    """What is to be seen."""

    qpos: NDArray[np.float64]
    """(nq,)"""
    time_s: float
    text: tuple[str, str] = ("", "")
    """Two columns."""
    witness_m: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
    """Ends of the line drawn between the most urgent pair."""


@dataclass(frozen=True)
class Reading:
    """What the person has done."""

    number: int
    """Counts the readings."""
    markers: dict[str, Pose]
    """Pose of every live arm's marker."""


class Window:
    """A window, open while the context lasts.

    Args:
        scene_xml: The scene.
        markers: Pose at which each live arm's marker starts.
        qpos: (nq,) what is seen first.
        gamepad: Also read the first gamepad.

    Raises:
        InputError: there is no display or no gamepad.
    """

    def __init__(
        self,
        scene_xml: Path,
        markers: dict[str, Pose],
        qpos: NDArray[np.float64],
        *,
        gamepad: bool = False,
    ):
        self._model = _with_markers(scene_xml, list(markers))
        self._data = mujoco.MjData(self._model)
        self._mocap = {
            arm: int(self._model.body_mocapid[self._model.body(marker_name(arm)).id])
            for arm in markers
        }
        for arm, (position_m, wxyz) in markers.items():
            self._data.mocap_pos[self._mocap[arm]] = position_m
            self._data.mocap_quat[self._mocap[arm]] = wxyz
        self._keys = Keys(gamepad=gamepad)
        self._keyed = next(iter(self._mocap.values()))
        """The marker that keys and gamepad move: the first."""
        self._guard = threading.Lock()
        self._picture = Picture(np.array(qpos), 0.0)
        self._reading = Reading(0, self._poses())
        self._wishes = Steering()
        self._open = threading.Event()
        self._handle: Any = None
        self._threads: list[threading.Thread] = []
        self.frames = 0
        """Pictures shown."""

    def __enter__(self) -> Window:
        before = set(threading.enumerate())
        try:
            self._handle = mujoco.viewer.launch_passive(
                self._model,
                self._data,
                key_callback=self._keys.press,
                show_left_ui=False,
                show_right_ui=False,
            )
        except Exception as error:  # GLFW and MuJoCo raise what they like where there is no display
            raise InputError(
                f"the viewer cannot be opened: {error}; a display is needed (DISPLAY)"
            ) from error
        self._viewer_threads = set(threading.enumerate()) - before
        with self._handle.lock():
            for effect in _COSTLY_EFFECTS:
                self._handle.user_scn.flags[effect] = 0
            # Distance sensors would be drawn as well, from data that is not computed here.
            self._handle.opt.flags[mujoco.mjtVisFlag.mjVIS_RANGEFINDER] = 0
            camera, there = self._handle.cam, self._data.mocap_pos[self._keyed]
            camera.lookat, camera.distance = there, VIEW_DISTANCE_M
            camera.azimuth, camera.elevation = VIEW_ANGLES_DEG
        self._open.set()
        self._threads = [
            threading.Thread(target=loop, daemon=True) for loop in (self._frames, self._texts)
        ]
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._open.clear()
        for thread in self._threads:
            thread.join(CLOSING_S)
        self._handle.close()
        # Leaving while the viewer still draws would end the process in its driver.
        for thread in self._viewer_threads:
            thread.join(CLOSING_S)

    @property
    def is_open(self) -> bool:
        """False once the person has closed it."""
        return self._open.is_set()

    def show(self, picture: Picture) -> None:
        """Set what is drawn next; never waits for the screen."""
        with self._guard:
            self._picture = picture

    def read(self) -> tuple[Reading, Steering]:
        """The latest reading, and what was asked for since the last call."""
        with self._guard:
            wishes, self._wishes = self._wishes, Steering()
            return self._reading, wishes

    def _frames(self) -> None:
        """Draw and read until the window is closed."""
        last_s = time.perf_counter()
        while self._open.is_set():
            if not self._handle.is_running():
                self._open.clear()
                return
            now_s = time.perf_counter()
            steering = self._keys.take(now_s - last_s)
            last_s = now_s
            with self._guard:
                picture = self._picture
            with self._handle.lock():
                data, marker = self._data, self._keyed
                data.mocap_pos[marker], data.mocap_quat[marker] = steering.moved(
                    data.mocap_pos[marker], data.mocap_quat[marker]
                )
                data.qpos[:] = picture.qpos
                data.time = picture.time_s
                # Kinematics alone: no forces, no control callback, no mouse that pushes arms.
                mujoco.mj_kinematics(self._model, data)
                mujoco.mj_camlight(self._model, data)
                self._draw_witness(picture)
            self._handle.sync()
            self.frames += 1
            with self._guard:
                self._reading = Reading(self._reading.number + 1, self._poses())
                self._wishes = self._wishes.and_then(steering)
            time.sleep(FRAME_S)

    def _texts(self) -> None:
        """Apart from the pictures, since setting a text waits until it is drawn."""
        while self._open.is_set() and self._handle.is_running():
            with self._guard:
                text = self._picture.text
            font, place = mujoco.mjtFontScale.mjFONTSCALE_100, mujoco.mjtGridPos.mjGRID_BOTTOMLEFT
            self._handle.set_texts((font, place, *text))
            time.sleep(TEXT_S)

    def _draw_witness(self, picture: Picture) -> None:
        scene = self._handle.user_scn
        scene.ngeom = 0
        if picture.witness_m is None:
            return
        line, kind = scene.geoms[0], mujoco.mjtGeom.mjGEOM_LINE
        mujoco.mjv_initGeom(line, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), _WITNESS_RGBA)
        mujoco.mjv_connector(line, kind, _WITNESS_WIDTH, *picture.witness_m)
        scene.ngeom = 1

    def _poses(self) -> dict[str, Pose]:
        return {
            arm: (self._data.mocap_pos[mocap].copy(), self._data.mocap_quat[mocap].copy())
            for arm, mocap in self._mocap.items()
        }


def marker_name(arm: str) -> str:
    """Name of the draggable body of an arm."""
    return f"target_{arm}"


def _with_markers(scene_xml: Path, arms: list[str]) -> mujoco.MjModel:
    """The scene plus a body for each arm's target, which the mouse can drag."""
    spec = mujoco.MjSpec.from_file(str(scene_xml))
    for arm in arms:
        body = spec.worldbody.add_body(name=marker_name(arm), mocap=True)
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=MARKER_HALF_EXTENTS_M,
            rgba=MARKER_RGBA,
            contype=0,
            conaffinity=0,
        )
    return spec.compile()
