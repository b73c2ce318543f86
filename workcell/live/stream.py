"""A live run for a rerun viewer that may come and go.

Nothing is sent unless somebody listens: a stream without a listener queues and, once the queue is
full, blocks for ever. So a thread of its own tries the port before connecting and again every
second; where the viewer has gone, the stream is dropped, and made anew when it is back.
"""

from __future__ import annotations

import math
import socket
import threading
import time
import uuid

import mujoco
import rerun as rr

from workcell.control.record import TickRecord
from workcell.scene.cell import Cell
from workcell.view.geometry import body_surfaces

PORT = 9876
"""The rerun viewer's own default."""
PROBE_S = 1.0
"""Time between two tries of the port; chosen as what a person waits without wondering."""
PROBE_TIMEOUT_S = 0.05
PERIOD_S = 0.05
"""Time between two states sent; chosen fluent enough to follow, at a few percent of a tick's time."""


class Stream:
    """Sends the present state of a run to a viewer on this machine, if there is one.

    Args:
        cell: What is simulated.
        port: Where the viewer listens.
    """

    def __init__(self, cell: Cell, *, port: int = PORT):
        self._cell, self._port = cell, port
        self._surfaces = list(body_surfaces(cell.model, [arm.name for arm in cell.arms]))
        self._recording: rr.RecordingStream | None = None
        self._next_state_s = -math.inf
        self.sent = 0
        """States sent so far."""
        self._closing = threading.Event()
        self._tender = threading.Thread(target=self._tend, daemon=True)
        self._tender.start()

    def show(self, record: TickRecord, data: mujoco.MjData) -> None:
        """Send a tick, if it is time for one and somebody listens."""
        now, recording = time.monotonic(), self._recording
        if recording is None or now < self._next_state_s:
            return
        self._next_state_s = now + PERIOD_S
        recording.set_time("sim_time", duration=record.time_s)
        recording.set_time("tick", sequence=record.tick)
        for body, entity, _ in self._surfaces:
            if self._cell.model.body_weldid[body] != 0:
                w, x, y, z = data.xquat[body]
                recording.log(
                    entity,
                    rr.Transform3D(
                        translation=data.xpos[body], quaternion=rr.Quaternion(xyzw=[x, y, z, w])
                    ),
                )
        if record.ttc_s is not None:
            recording.log("ttc/measured", rr.Scalars(record.ttc_s))
        recording.log("mode/cell", rr.TextLog(record.mode))
        for name, row in record.arms.items():
            recording.log(f"scale/{name}", rr.Scalars(row.scale))
        self.sent += 1

    def close(self) -> None:
        """End the stream."""
        self._closing.set()
        self._tender.join()
        self._drop()

    def _tend(self) -> None:
        self._attend()
        while not self._closing.wait(PROBE_S):
            self._attend()

    def _attend(self) -> None:
        """Connect where a viewer has come, drop the stream where it has gone."""
        listening = self._listening()
        if self._recording is not None and not listening:
            self._drop()
        elif self._recording is None and listening:
            recording = rr.RecordingStream("workcell", recording_id=str(uuid.uuid4()))
            recording.connect_grpc(f"rerun+http://127.0.0.1:{self._port}/proxy")
            recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
            for body, entity, surface in self._surfaces:
                recording.log(entity, surface, static=True)
                if self._cell.model.body_weldid[body] == 0:
                    self._place(recording, body, entity)
            self._recording = recording

    def _place(self, recording: rr.RecordingStream, body: int, entity: str) -> None:
        """A body that never moves, once."""
        data = mujoco.MjData(self._cell.model)
        mujoco.mj_kinematics(self._cell.model, data)
        w, x, y, z = data.xquat[body]
        pose = rr.Transform3D(
            translation=data.xpos[body], quaternion=rr.Quaternion(xyzw=[x, y, z, w])
        )
        recording.log(entity, pose, static=True)

    def _drop(self) -> None:
        recording, self._recording = self._recording, None
        if recording is not None:
            # Ending a stream whose viewer is gone waits some seconds for it: not in the loop.
            threading.Thread(target=recording.disconnect, daemon=True).start()

    def _listening(self) -> bool:
        with socket.socket() as probe:
            probe.settimeout(PROBE_TIMEOUT_S)
            return probe.connect_ex(("127.0.0.1", self._port)) == 0
