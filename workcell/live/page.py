"""The live page: a scene to drag tools in and the instruments over it, in any browser on this machine.

The page runs in threads of its own. The control loop sets a picture and asks for the hands' poses; it
never waits for a browser. The first browser drives, the others watch. What the person holds (keys, jog
buttons, sticks) is told twenty times a second; when that stops, keys count as released after `KEYS_S`,
and after `ALIVE_S` no more samples reach the live operator, which then stands and says so.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import viser

from workcell.live.camera import FIELD_OF_VIEW_RAD, CameraView
from workcell.live.controls import ON_THE_PAGE, Held, ask, held_in
from workcell.live.desk import COUNTING, PAUSED, READY, RUNNING, Picture, Say, Tool
from workcell.live.devices import PAGE_MOVES, PAGE_TURNS, DeviceInput, key_motion, stick_motion
from workcell.live.drawing import Drawing
from workcell.live.latency import LatencyMeter
from workcell.live.marker import Marker, Pose
from workcell.live.server import PORT, PageServer, calling_browser, ssh_command
from workcell.live.status import ttc_words

FRAME_S = 1 / 25
"""Time between two pictures; chosen fluent, at a tenth of a core."""
COUNT_S = 3.0
SEEN_S = 1.0
"""Longest wait for a browser to have drawn a picture before the next is sent."""
KEYS_S = 0.4
"""Without a word from the driver for so long, held keys count as released; chosen eight times the beat of the page."""
ALIVE_S = 1.0
"""And for so long, the input counts as stopped; chosen beyond the pauses of a browser that is drawing."""
GONE_S = 10.0
"""Without any browser for so long, the session ends; chosen longer than it takes to reload a page."""
CURVE_S = 20.0
_CURVE_EVERY_S = 0.1


class Page:
    """A page, served while the context lasts.

    Args:
        scene_xml: The scene.
        markers: Pose at which each live arm's marker starts.
        cameras: Views to choose from; the first is shown at the start.
        port: Where it is served.
        title: Of the page.
        say: Takes the lines that say where it is.

    Raises:
        InputError: the port is taken, or the page cannot be guarded.
    """

    def __init__(
        self,
        scene_xml: Path,
        markers: dict[str, Pose],
        cameras: dict[str, CameraView],
        *,
        port: int = PORT,
        title: str = "workcell",
        say: Say = print,
    ):
        self._scene_xml, self._cameras, self._port = scene_xml, cameras, port
        self._title, self._say = title, say
        self._guard = threading.RLock()
        self._markers = {arm: Marker(*pose) for arm, pose in markers.items()}
        self._selected = next(iter(markers))
        """The arm that keys and sticks move."""
        self._browsers: set[str] = set()
        self._clients: dict[int, tuple[viser.ClientHandle, str]] = {}
        self._driver: str | None = None
        self._alone_since_s: float | None = None
        self._held = Held()
        self._asked = DeviceInput()
        self._hands_s: float | None = None
        self._phase, self._count_ends_s = READY, 0.0
        self._begun = False
        """Whether there is a run to be started; until then the count stays at one."""
        self._picture: Picture | None = None
        self._curve: deque[tuple[float, float | None, float]] = deque()
        self._followers: dict[int, np.ndarray] = {}
        self._closing = threading.Event()
        self._seen = threading.Event()
        """Set when the driver's browser has drawn the last picture."""
        self.latency = LatencyMeter()
        self.frames = 0
        self.error: BaseException | None = None
        """What ended the drawing, if anything did."""

    def __enter__(self) -> Page:
        self._server = PageServer(self._port, title=self._title, listener=self)
        try:
            self._open()
        except BaseException:
            self._server.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.set()
        self._artist.join(5.0)
        self._server.close()

    def _open(self) -> None:
        """Draw the scene, listen, and say where the page is."""
        self._drawing = Drawing(self._server.viser, self._scene_xml, list(self._markers))
        scene = self._server.viser
        scene.gui.configure_theme(
            dark_mode=True, show_logo=False, show_share_button=False, control_layout="floating"
        )
        first = next(iter(self._cameras.values()))
        scene.initial_camera.fov = FIELD_OF_VIEW_RAD
        scene.initial_camera.position = first.position_m
        scene.initial_camera.look_at = first.look_at_m
        scene.on_client_connect(self._client_came)
        scene.on_client_disconnect(self._client_went)
        self._artist = threading.Thread(target=self._draw, daemon=True)
        self._artist.start()
        self._say(f"open {self._server.address}")
        self._say(
            f"from another machine, first: {ssh_command(self._server.port)}; then open the same address there"
        )

    @property
    def address(self) -> str:
        """The page, with its token."""
        return self._server.address

    # ---------------------------------------------------------------- what the run asks

    @property
    def is_open(self) -> bool:
        """False once every browser has been gone for `GONE_S`."""
        alone = self._alone_since_s
        if self.error is not None:
            return False
        return alone is None or time.monotonic() - alone < GONE_S

    @property
    def phase(self) -> str:
        """See `workcell.live.desk`."""
        with self._guard:
            counted = self._phase == COUNTING and time.monotonic() >= self._count_ends_s
            if counted and self._begun:
                self._phase = RUNNING
            return self._phase

    @property
    def out_of_reach(self) -> frozenset[str]:
        with self._guard:
            return frozenset(a for a, marker in self._markers.items() if marker.out_of_reach)

    def begin(self, poses: dict[str, Pose]) -> None:
        with self._guard:
            for arm, pose in poses.items():
                held = self._markers[arm].held
                self._markers[arm] = Marker(*pose)
                self._markers[arm].held = held
            # The phase stays: who has pressed Start while the cell was being prepared is not asked again.
            self._hands_s, self._begun = None, True
            self._curve.clear()

    def hands(self, tools: dict[str, Tool]) -> dict[str, Pose] | None:
        with self._guard:
            now_s = time.monotonic()
            passed_s = 0.0 if self._hands_s is None else min(now_s - self._hands_s, KEYS_S)
            self._hands_s = now_s
            silent_s = now_s - self._held.told_s
            if silent_s < KEYS_S:
                self._push(passed_s)
            hands = {
                arm: self._markers[arm].follow(passed_s, tool.pose, tool.short, tool.speed_m_s)
                for arm, tool in tools.items()
            }
            return hands if silent_s < ALIVE_S else None

    def asked(self) -> DeviceInput:
        with self._guard:
            asked, self._asked = self._asked, DeviceInput()
            return asked

    def show(self, picture: Picture) -> None:
        self._picture = picture

    def conclude(self, report: str) -> None:
        self._server.send({"kind": "report", "text": report})
        time.sleep(0.5)  # until the browsers have it, before the server goes

    # ---------------------------------------------------------------- what browsers do

    def came(self, browser: str) -> None:
        """See `workcell.live.server.Listener`."""
        with self._guard:
            self._browsers.add(browser)
            self._alone_since_s = None
            if self._driver is None:
                self._drive(browser)
        self._greet()

    def went(self, browser: str) -> None:
        """See `workcell.live.server.Listener`."""
        with self._guard:
            self._browsers.discard(browser)
            if browser == self._driver:
                self._drive(None)
            if not self._browsers:
                self._alone_since_s = time.monotonic()
        self._greet()

    def heard(self, browser: str, message: dict[str, Any]) -> None:
        """See `workcell.live.server.Listener`; what makes no sense is not acted on."""
        kind = message["kind"]
        with self._guard:
            if kind == "camera":
                self._look_from(browser, message.get("name"))
            elif kind == "seen" and browser == self._driver:
                self._seen.set()
            elif kind == "take" and self._driver is None:
                self._drive(browser)
                self._greet()
            elif browser == self._driver:
                if kind == "alive":
                    self._hold(message)
                elif kind == "act":
                    self._act(browser, message.get("action"))
                elif kind == "arm" and message.get("name") in self._markers:
                    self._selected = message["name"]

    def _greet(self) -> None:
        """Tell every browser who it is now."""
        with self._guard:
            browsers, driver = set(self._browsers), self._driver
            curve = list(self._curve)
        for browser in browsers:
            self._server.send(
                {
                    "kind": "hello",
                    "driver": browser == driver,
                    "taken": driver is not None,
                    "arms": list(self._markers),
                    "cameras": list(self._cameras),
                    **ON_THE_PAGE,
                },
                browser=browser,
            )
            self._server.send({"kind": "history", "curve": curve}, browser=browser)

    def _drive(self, browser: str | None) -> None:
        """Give the drive to a browser, or to none."""
        self._driver, self._held = browser, Held()
        for marker in self._markers.values():
            marker.held = False
            marker.clutch(False)
        for client_id, (client, owner) in self._clients.items():
            self._drawing.take_gizmos(client_id)
            if owner == browser:
                self._give_gizmos(client)

    async def _client_came(self, client: viser.ClientHandle) -> None:
        browser = calling_browser()
        with self._guard:
            self._clients[client.client_id] = (client, browser)
            if browser == self._driver:
                self._give_gizmos(client)

    async def _client_went(self, client: viser.ClientHandle) -> None:
        with self._guard:
            self._clients.pop(client.client_id, None)
            self._followers.pop(client.client_id, None)
            self._drawing.take_gizmos(client.client_id, gone=True)

    def _give_gizmos(self, client: viser.ClientHandle) -> None:
        self._drawing.give_gizmos(client, self._markers, grabbed=self._grabbed, moved=self._moved)

    def _grabbed(self, arm: str, whether: bool) -> None:
        with self._guard:
            self._markers[arm].held = whether

    def _moved(self, arm: str, pose: Pose) -> None:
        with self._guard:
            self._markers[arm].place(*pose)
        self.latency.begin()

    def _hold(self, message: dict[str, Any]) -> None:
        before, held = self._held, held_in(message)
        self._held = held
        self._markers[self._selected].clutch(bool(message.get("clutch")))
        if (held.codes and not before.codes) or (held.axes.any() and not before.axes.any()):
            self.latency.begin()

    def _act(self, browser: str, action: Any) -> None:
        if action == "start":
            self._start_or_pause()
        elif action == "follow":
            self._follow(browser)
        elif isinstance(action, str):
            ask(self._asked, action)
            if action == "reset":
                self._phase, self._begun = READY, False

    def _start_or_pause(self) -> None:
        phase = self.phase
        if phase == READY:
            self._phase, self._count_ends_s = COUNTING, time.monotonic() + COUNT_S
        elif phase in (RUNNING, PAUSED):
            self._phase = PAUSED if phase == RUNNING else RUNNING
            self._hands_s = None

    def _push(self, passed_s: float) -> None:
        """Move the selected marker by what is held, as the driver's picture shows it."""
        held, marker = self._held, self._markers[self._selected]
        way, turn = key_motion(
            [PAGE_MOVES[c] for c in held.codes & PAGE_MOVES.keys()],
            [PAGE_TURNS[c] for c in held.codes & PAGE_TURNS.keys()],
            passed_s,
            slow=held.slow,
        )
        stick_way, stick_turn = stick_motion(held.axes, passed_s)
        way, turn = way + stick_way, turn + stick_turn
        if way.any() or turn.any():
            picture = self._heading()
            marker.push(picture @ way, picture @ turn)

    def _heading(self) -> np.ndarray:
        """(3, 3) turns right, away, up of the driver's picture into the world, to the nearest quarter."""
        azimuth = math.pi / 2.0
        for client, browser in self._clients.values():
            if browser == self._driver:
                ahead = np.asarray(client.camera.look_at) - np.asarray(client.camera.position)
                if np.hypot(ahead[0], ahead[1]) > 1e-6:
                    azimuth = math.atan2(ahead[1], ahead[0])
        quarter = round((azimuth - math.pi / 2.0) / (math.pi / 2.0))
        cosine, sine = ((1, 0), (0, 1), (-1, 0), (0, -1))[quarter % 4]
        return np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])

    def _look_from(self, browser: str, name: Any) -> None:
        view = self._cameras.get(name) if isinstance(name, str) else None
        if view is None:
            return
        for client, owner in self._clients.values():
            if owner == browser:
                client.camera.position = view.position_m
                client.camera.look_at = view.look_at_m

    def _follow(self, browser: str) -> None:
        """Let the cameras of a browser go with the selected tool, or stop doing so."""
        for client_id, (_, owner) in self._clients.items():
            if owner == browser and self._followers.pop(client_id, None) is None:
                self._followers[client_id] = np.array(self._markers[self._selected].hand[0])

    # ---------------------------------------------------------------- what browsers see

    def _draw(self) -> None:
        """Send pictures until the page is closed."""
        try:
            while not self._closing.wait(FRAME_S):
                picture = self._picture
                if picture is None:
                    continue
                if self._driver is not None:
                    self._seen.wait(SEEN_S)
                self._seen.clear()
                self._drawing.show(picture, dict(self._markers))
                self._move_cameras()
                self._server.send(self._state(picture))
                self.frames += 1
        except BaseException as error:  # a page that has stopped must not look like one that works
            self.error = error

    def _move_cameras(self) -> None:
        with self._guard:
            there = np.array(self._markers[self._selected].hand[0])
            for client_id, before in list(self._followers.items()):
                client, _ = self._clients[client_id]
                if np.linalg.norm(there - before) > 1e-3:
                    client.camera.position = np.asarray(client.camera.position) + there - before
                    self._followers[client_id] = there

    def _state(self, picture: Picture) -> dict[str, Any]:
        phase, now = self.phase, picture.status
        message: dict[str, Any] = {
            "kind": "state",
            "phase": phase,
            "count": max(1, math.ceil(self._count_ends_s - time.monotonic())),
            "speed": picture.pace,
            "slow": picture.slow,
            "recording": picture.recording,
            "selected": self._selected,
            "frames": self.frames,
            "hands": {arm: marker.hand[0].tolist() for arm, marker in self._markers.items()},
            "out_of_reach": sorted(self.out_of_reach),
        }
        if now is None:
            return message | {
                "time_s": 0.0, "ttc_s": None, "ttc_words": "–", "artc_per_s": 0.0, "t_min_s": 0.0,
                "colour": "green", "pair": "", "distance_m": None, "criterion": "", "entry": "",
                "halt": "", "arms": [],
            }  # fmt: skip
        if phase == RUNNING:
            self._remember(now.time_s, now.ttc_s, now.artc_per_s)
        return message | asdict(now) | {"ttc_words": ttc_words(now.ttc_s)}

    def _remember(self, time_s: float, ttc_s: float | None, artc_per_s: float) -> None:
        with self._guard:
            curve = self._curve
            if not curve or time_s >= curve[-1][0] + _CURVE_EVERY_S:
                curve.append((time_s, ttc_s, artc_per_s))
            while curve[0][0] < time_s - CURVE_S:
                curve.popleft()
