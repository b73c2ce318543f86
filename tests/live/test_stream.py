"""A live run and a rerun viewer that comes, goes and comes back."""

from __future__ import annotations

import socket
import subprocess
import time

import mujoco
import pytest

from tests import cells
from workcell.control.controller import Controller
from workcell.live.stream import Stream
from workcell.trace.rerun_viewer import viewer_binary


def test_a_stream_serves_a_viewer_that_comes_and_goes(tmp_path):
    cell = cells.build(tmp_path, cells.duet())
    data = mujoco.MjData(cell.model)
    cell.place_home(data)
    mujoco.mj_kinematics(cell.model, data)
    record = Controller(cell).step(data.qpos, data.qvel)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    stream = Stream(cell, port=port)

    def serve(until, longest_s):
        """Show states until something is so."""
        deadline = time.monotonic() + longest_s
        while time.monotonic() < deadline and not until():
            stream.show(record, data)
            time.sleep(0.01)
        return until()

    def viewer():
        command = [viewer_binary(), "--headless", "--bind", "127.0.0.1", "--port", str(port)]
        return subprocess.Popen(
            [*command, "--hide-welcome-screen"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    assert not serve(lambda: stream.sent > 0, 0.5)  # nobody there: nothing sent, nothing blocked
    process = viewer()
    try:
        if not serve(lambda: stream.sent > 5, 20.0) and process.poll() is not None:
            pytest.skip("no Vulkan driver: the rerun viewer does not start")
        assert stream.sent > 5
        process.terminate()
        process.wait(10)
        assert serve(lambda: stream._recording is None, 10.0)
        before = stream.sent
        process = viewer()
        assert serve(lambda: stream.sent > before + 5, 20.0)
    finally:
        process.terminate()
        process.wait(10)
        stream.close()
