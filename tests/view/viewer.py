"""Opens a recording in the real viewer, without a screen, and looks at it."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from rerun.experimental import ViewerClient

from workcell.trace.rerun_viewer import viewer_binary

SETTLED_FRAMES = 8
"""Frames after which axes have settled and start-up notices are gone (they go by frames)."""


class NoDriver(Exception):
    """The machine has no Vulkan driver the viewer could draw with."""


class Sight(NamedTuple):
    views: set[str]
    """Names of the views."""
    problems: list[tuple[str, str]]
    """View and what it complains about."""
    errors: list[str]
    """Error lines of the viewer's own log."""
    timelines: set[str]
    """Names of the timelines."""


@contextmanager
def _viewer(rrd: Path, log: Path, size: str, timeout_s: float) -> Iterator[Any]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [viewer_binary(), "--headless", "--bind", "127.0.0.1", "--port", str(port)]
    command += ["--window-size", size, "--hide-welcome-screen", rrd.resolve()]
    deadline = time.monotonic() + timeout_s
    with log.open("w") as out:
        process = subprocess.Popen(command, stdout=out, stderr=out, start_new_session=True)
    try:
        client = None
        while True:
            if process.poll() is not None:
                said = log.read_text()
                if "render context" in said or "adapter" in said:
                    raise NoDriver(said[-400:])
                raise RuntimeError(f"the viewer ended with {process.returncode}: {said[-400:]}")
            if time.monotonic() > deadline:
                raise TimeoutError(f"the viewer did not load {rrd}: {log.read_text()[-400:]}")
            try:
                client = client or ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
                state = client.get_state()
            except (ConnectionError, RuntimeError, ValueError):
                time.sleep(0.1)  # It is still starting.
                continue
            if not state.loading and any(r.timelines for r in state.recordings):
                break
            time.sleep(0.1)
        yield client
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGTERM)
            process.wait(10)


def look(rrd: Path, out_png: Path, time_s: float, *, size: str = "1500x950") -> Sight:
    """Takes a picture of the recording at a time, and says what the viewer thinks of it.

    Raises:
        NoDriver: There is nothing to draw with.
    """
    with _viewer(rrd, out_png.with_suffix(".log"), size, 60.0) as client:
        client.set_time("sim_time", duration=time_s, play_state="paused")
        for _ in range(SETTLED_FRAMES):
            picture = client.take_screenshot()
        out_png.write_bytes(picture)
        state = client.get_state()
        return Sight(
            views={view.name for view in state.views},
            problems=[(view.name, r.summary) for view in state.views for r in view.reports],
            errors=[line.message for line in client.get_logs() if line.level == "ERROR"],
            timelines={t.name for r in state.recordings for t in r.timelines},
        )
