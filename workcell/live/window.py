"""The window of a live run: MuJoCo's passive viewer, drawn and read by threads of its own.

In go pictures of the plant (joint positions, text, a line between witness points), out come the
poses of the markers that mouse, keys and gamepad have moved. The control loop never waits for the
screen: a slow one shows fewer pictures. The model shown is the scene plus one marker for every live
arm, on data of its own, so that nothing done in the window can push the simulated arms.
"""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Any

import mujoco
import mujoco.viewer
import numpy as np
from numpy.typing import NDArray

from workcell.errors import InputError
from workcell.live.camera import CameraView
from workcell.live.desk import RUNNING, Picture, Tool
from workcell.live.devices import DeviceInput, WindowKeys
from workcell.live.keyboard import Keyboard
from workcell.live.latency import LatencyMeter
from workcell.live.marker import Marker, Pose
from workcell.live.status import AMBER, GREEN, RED, ttc_words

FRAME_S = 1 / 60
"""Time between two pictures, and between two readings of mouse and keys: screens redraw at 60 Hz."""
READ_S = 0.5
"""A window that has read no mouse for so long counts as silent; chosen beyond the pauses of a slow renderer."""
TEXT_S = 0.2
"""Time between two texts; chosen as fast as digits can be read."""
CLOSING_S = 5.0
"""Longest wait for the viewer to end, so that a stuck driver does not hold the run's results back."""
MARKER_RADIUS_M = 0.05
"""Half extent of the marker; chosen so that a double click hits it from where the camera stands."""
_RGBA = {
    GREEN: np.array([0.27, 0.82, 0.48, 1.0], dtype=np.float32),
    AMBER: np.array([1.0, 0.72, 0.22, 1.0], dtype=np.float32),
    RED: np.array([1.0, 0.35, 0.32, 1.0], dtype=np.float32),
}
_MARKER_ALPHA = 0.6
_WITNESS_WIDTH = 4.0
_AHEAD_WIDTH = 2.0
_AHEAD_RGBA = np.array([0.55, 0.62, 0.72, 0.6], dtype=np.float32)
_COSTLY_EFFECTS = (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION)
"""Effects that cost more than they show where a processor has to draw."""


class Window:
    """A window, open while the context lasts.

    Args:
        scene_xml: The scene.
        markers: Pose at which each live arm's marker starts.
        qpos: (nq,) what is seen first.
        view: Where the camera starts.
        gamepad: Also read the first gamepad.

    Raises:
        InputError: there is no display or no gamepad.
    """

    def __init__(
        self,
        scene_xml: Path,
        markers: dict[str, Pose],
        qpos: NDArray[np.float64],
        view: CameraView,
        *,
        gamepad: bool = False,
    ):
        self._model = _with_markers(scene_xml, list(markers))
        self._data = mujoco.MjData(self._model)
        self._view = view
        self._bodies = {arm: self._model.body(marker_name(arm)).id for arm in markers}
        self._mocap = {a: int(self._model.body_mocapid[body]) for a, body in self._bodies.items()}
        self._markers = {arm: Marker(*pose) for arm, pose in markers.items()}
        self._keyboard = Keyboard()
        self._keys = WindowKeys(self._keyboard.held, gamepad=gamepad)
        self._keyed = next(iter(self._markers))
        """The marker that keys and gamepad move: the first."""
        self._guard = threading.RLock()
        self._picture = Picture(np.array(qpos), 0.0)
        self._asked = DeviceInput()
        self._hands_s: float | None = None
        self._read_s = -np.inf
        self._open = threading.Event()
        self._handle: Any = None
        self._threads: list[threading.Thread] = []
        self.latency = LatencyMeter()
        self.frames = 0
        self._write_markers()

    def __enter__(self) -> Window:
        before = set(threading.enumerate())
        try:
            self._handle = mujoco.viewer.launch_passive(
                self._model,
                self._data,
                key_callback=self._key,
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
            self._aim()
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

    @property
    def phase(self) -> str:
        """A window is not started; it runs."""
        return RUNNING

    @property
    def out_of_reach(self) -> frozenset[str]:
        with self._guard:
            return frozenset(a for a, marker in self._markers.items() if marker.out_of_reach)

    def begin(self, poses: dict[str, Pose]) -> None:
        with self._guard:
            self._markers = {arm: Marker(*pose) for arm, pose in poses.items()}
            self._hands_s = None

    def hands(self, tools: dict[str, Tool]) -> dict[str, Pose] | None:
        with self._guard:
            now_s = time.perf_counter()
            passed_s = 0.0 if self._hands_s is None else now_s - self._hands_s
            self._hands_s = now_s
            hands = {
                arm: self._markers[arm].follow(passed_s, tool.pose, tool.short, tool.speed_m_s)
                for arm, tool in tools.items()
            }
            # A window that has stopped reading the mouse gives no samples: the operator says so.
            return hands if now_s - self._read_s < READ_S else None

    def asked(self) -> DeviceInput:
        with self._guard:
            asked, self._asked = self._asked, DeviceInput()
            return asked

    def show(self, picture: Picture) -> None:
        with self._guard:
            self._picture = picture

    def conclude(self, report: str) -> None:
        """The terminal shows the report; the window closes."""

    # ---------------------------------------------------------------- the viewer's threads

    def _key(self, key: int) -> None:
        """MuJoCo's callback, in the viewer's own thread: once a press."""
        if self._keyboard.attach(self._keys.press):
            self._keys.press(key)  # from now on the keyboard itself tells

    def _aim(self) -> None:
        """Put the camera where it was chosen to be."""
        camera, ahead = self._handle.cam, self._view.look_at_m - self._view.position_m
        camera.lookat = self._view.look_at_m
        camera.distance = float(np.linalg.norm(ahead))
        camera.azimuth = float(np.degrees(np.arctan2(ahead[1], ahead[0])))
        camera.elevation = float(np.degrees(np.arcsin(ahead[2] / camera.distance)))

    def _frames(self) -> None:
        """Draw and read until the window is closed."""
        last_s = time.perf_counter()
        while self._open.is_set():
            if not self._handle.is_running():
                self._open.clear()
                return
            now_s = time.perf_counter()
            asked = self._keys.take(now_s - last_s)
            last_s = now_s
            if asked.way_m.any() or asked.turn_rad.any():
                self.latency.begin()
            with self._handle.lock(), self._guard:
                picture = self._picture
                self._read_markers()
                self._markers[self._keyed].push(asked.way_m, asked.turn_rad)
                self._write_markers()
                self._data.qpos[:] = picture.qpos
                self._data.time = picture.time_s
                # Kinematics alone: no forces, no control callback, no mouse that pushes arms.
                mujoco.mj_kinematics(self._model, self._data)
                mujoco.mj_camlight(self._model, self._data)
                self._draw(picture)
                self._asked = self._asked.and_then(asked)
                self._read_s = now_s
            self._handle.sync()
            self.frames += 1
            time.sleep(FRAME_S)

    def _texts(self) -> None:
        """Apart from the pictures, since setting a text waits until it is drawn."""
        while self._open.is_set() and self._handle.is_running():
            with self._guard:
                text = status_text(self._picture)
            font, place = mujoco.mjtFontScale.mjFONTSCALE_100, mujoco.mjtGridPos.mjGRID_BOTTOMLEFT
            keys = (mujoco.mjtFontScale.mjFONTSCALE_100, mujoco.mjtGridPos.mjGRID_TOPLEFT, *KEYS)
            self._handle.set_texts([(font, place, *text), keys])
            time.sleep(TEXT_S)

    def _read_markers(self) -> None:
        """What the mouse has done to the markers since they were written."""
        for arm, mocap in self._mocap.items():
            pose = self._data.mocap_pos[mocap].copy(), self._data.mocap_quat[mocap].copy()
            if not all(map(np.array_equal, pose, self._written[arm])):
                self._markers[arm].place(*pose)
                self.latency.begin()

    def _write_markers(self) -> None:
        self._written: dict[str, Pose] = {}
        for arm, mocap in self._mocap.items():
            marker = self._markers[arm]
            self._data.mocap_pos[mocap], self._data.mocap_quat[mocap] = marker.wish
            self._written[arm] = (
                self._data.mocap_pos[mocap].copy(),
                self._data.mocap_quat[mocap].copy(),
            )
            geom = self._model.body_geomadr[self._bodies[arm]]
            rgba = _RGBA[RED if marker.out_of_reach else GREEN]
            self._model.geom_rgba[geom] = [*rgba[:3], _MARKER_ALPHA]

    def _draw(self, picture: Picture) -> None:
        """The line of the closest pair, and what lies ahead of the support arms."""
        scene = self._handle.user_scn
        scene.ngeom = 0
        if picture.witness_m is not None and picture.status is not None:
            _line(scene, picture.witness_m, _WITNESS_WIDTH, _RGBA[picture.status.colour])
        for points in picture.ahead_m.values():
            for ends in zip(points[:-1:2], points[1::2], strict=False):
                _line(scene, ends, _AHEAD_WIDTH, _AHEAD_RGBA)


KEYS = (
    "drag\nmove, turn\nslow, t_min, criterion\nfrom, go on, end",
    "double click the marker; Ctrl + right moves, + left turns it\narrows, Page Up/Down; keypad 46 28 79\nShift; 6 7; 8\nkeypad 1 left 5 above 3 right; 0; 9",
)
"""Two columns: what, and with which keys."""


def status_text(picture: Picture) -> tuple[str, str]:
    """Two columns of text for the screen: what, and its value."""
    now = picture.status
    if now is None:
        return "ready", ""
    distance = "" if now.distance_m is None else f", {1000 * now.distance_m:.0f} mm"
    lines = {
        "time": f"{now.time_s:.1f} s, {picture.pace}",
        f"time to collision ({now.colour})": f"{ttc_words(now.ttc_s)} of t_min {now.t_min_s:.2f} s",
        "between": now.pair + distance,
        "criterion": now.criterion,
        "presents from": now.entry or "as in the jobs",
        "late ticks": picture.missed,
    } | {arm.name + (" (you)" if arm.live else ""): arm.words for arm in now.arms}
    if now.halt:
        lines["stopped"] = f"{now.halt}; 0 goes on"
    return "\n".join(lines), "\n".join(line.replace("–", "-") for line in lines.values())


def marker_name(arm: str) -> str:
    """Name of the draggable body of an arm."""
    return f"target_{arm}"


def _line(scene: Any, ends: Any, width: float, rgba: NDArray[np.float32]) -> None:
    if scene.ngeom >= scene.maxgeom:
        return
    line, kind = scene.geoms[scene.ngeom], mujoco.mjtGeom.mjGEOM_LINE
    mujoco.mjv_initGeom(line, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), rgba)
    mujoco.mjv_connector(line, kind, width, *ends)
    scene.ngeom += 1


def _with_markers(scene_xml: Path, arms: list[str]) -> mujoco.MjModel:
    """The scene plus a body for each arm's target, which the mouse can drag."""
    spec = mujoco.MjSpec.from_file(str(scene_xml))
    for arm in arms:
        body = spec.worldbody.add_body(name=marker_name(arm), mocap=True)
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[MARKER_RADIUS_M, 0.0, 0.0],
            rgba=[*_RGBA[GREEN][:3], _MARKER_ALPHA],
            contype=0,
            conaffinity=0,
        )
    return spec.compile()
