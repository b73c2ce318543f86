"""What is drawn in the scene of the live page, with viser and mjviser."""

from __future__ import annotations

import threading
from pathlib import Path

import mujoco
import numpy as np
import viser
from mjviser import ViserMujocoScene
from numpy.typing import NDArray

from workcell.live.desk import Picture
from workcell.live.marker import Marker, Pose
from workcell.live.status import AMBER, GREEN, RED

COLOURS = {GREEN: (70, 209, 123), AMBER: (255, 185, 56), RED: (255, 90, 82)}
AHEAD_COLOUR = (120, 140, 165)
MARKER_SIZE_M = (0.03, 0.03, 0.08)
GIZMO_M = 0.22
_MOVED = 1e-5
"""Change of a pose, in m or of the quaternion, below which nothing is sent."""
_NOWHERE = np.zeros((1, 2, 3), dtype=np.float32)


class Drawing:
    """The scene that all browsers share; gizmos only for those who drive.

    Args:
        server: viser's.
        scene_xml: What is simulated.
        arms: The live arms.
    """

    def __init__(self, server: viser.ViserServer, scene_xml: Path, arms: list[str]):
        self._server = server
        self._model = mujoco.MjModel.from_xml_path(str(scene_xml))
        self._data = mujoco.MjData(self._model)
        self._bodies = ViserMujocoScene(server, self._model, 1)
        self._bodies.camera_tracking_enabled = False
        self._lines = server.scene.add_line_segments(
            "/closest", _NOWHERE, COLOURS[GREEN], thickness=4.0
        )
        self._ahead = server.scene.add_line_segments(
            "/ahead", _NOWHERE, AHEAD_COLOUR, thickness=3.0
        )
        self._markers = {
            arm: server.scene.add_box(
                f"/marker/{arm}",
                color=COLOURS[GREEN],
                dimensions=MARKER_SIZE_M,
                opacity=0.65,
                cast_shadow=False,
            )
            for arm in arms
        }
        self._qpos: NDArray[np.float64] | None = None
        self._gizmos: dict[int, dict[str, viser.TransformControlsHandle]] = {}
        self._guard = threading.Lock()

    def show(self, picture: Picture, markers: dict[str, Marker]) -> None:
        """Draw one picture."""
        with self._server.atomic():
            if self._qpos is None or not np.array_equal(self._qpos, picture.qpos):
                self._qpos = self._data.qpos[:] = picture.qpos
                mujoco.mj_kinematics(self._model, self._data)
                self._bodies.update_from_mjdata(self._data)
            self._show_line(picture)
            self._show_ahead(picture)
            for arm, marker in markers.items():
                self._show_marker(arm, marker)

    def give_gizmos(
        self, client: viser.ClientHandle, markers: dict[str, Marker], *, grabbed, moved
    ) -> None:
        """Put a gizmo at every live tool, for one client.

        Args:
            client: Who drives.
            markers: By arm.
            grabbed: Called with (arm, whether) when a gizmo is taken and let go.
            moved: Called with (arm, pose) while it is dragged.
        """
        handles = {}
        for arm, marker in markers.items():
            handle = client.scene.add_transform_controls(
                f"/gizmo/{arm}",
                scale=GIZMO_M,
                depth_test=False,
                position=marker.wish[0],
                wxyz=marker.wish[1],
            )

            @handle.on_update
            async def _(event: viser.TransformControlsEvent, arm: str = arm) -> None:
                if event.phase in ("start", "end"):
                    grabbed(arm, event.phase == "start")
                moved(arm, (np.array(event.target.position), np.array(event.target.wxyz)))

            handles[arm] = handle
        with self._guard:
            self._gizmos[client.client_id] = handles

    def take_gizmos(self, client_id: int, *, gone: bool = False) -> None:
        """Take one client's gizmos away; of a client that is gone they are only forgotten."""
        with self._guard:
            handles = self._gizmos.pop(client_id, {})
        if not gone:
            for handle in handles.values():
                handle.remove()

    def _show_line(self, picture: Picture) -> None:
        shown = picture.witness_m is not None and picture.status is not None
        self._lines.visible = shown
        if shown:
            assert picture.witness_m is not None
            assert picture.status is not None
            self._lines.points = np.array([picture.witness_m], dtype=np.float32)
            self._lines.colors = np.full((1, 2, 3), COLOURS[picture.status.colour], dtype=np.uint8)

    def _show_ahead(self, picture: Picture) -> None:
        """Every other piece of the way: a broken line reads as what is only intended."""
        pieces = [
            np.stack([points[:-1:2], points[1::2]], axis=1)
            for points in picture.ahead_m.values()
            if len(points) > 1
        ]
        self._ahead.visible = bool(pieces)
        if pieces:
            points = np.concatenate(pieces).astype(np.float32)
            self._ahead.points = points
            self._ahead.colors = np.broadcast_to(
                np.array(AHEAD_COLOUR, dtype=np.uint8), points.shape
            ).copy()

    def _show_marker(self, arm: str, marker: Marker) -> None:
        box = self._markers[arm]
        _move(box, marker.hand)
        colour = COLOURS[RED if marker.out_of_reach else AMBER if marker.clutched else GREEN]
        if tuple(box.color) != colour:
            box.color = colour
        with self._guard:
            handles = [gizmos[arm] for gizmos in self._gizmos.values() if arm in gizmos]
        if not marker.held:
            for handle in handles:
                _move(handle, marker.wish)


def _move(handle: viser.SceneNodeHandle, pose: Pose) -> None:
    position, wxyz = pose
    if np.abs(np.asarray(handle.position) - position).max() > _MOVED:
        handle.position = position
    if np.abs(np.asarray(handle.wxyz) - wxyz).max() > _MOVED:
        handle.wxyz = wxyz
