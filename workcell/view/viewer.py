"""The rerun viewer as a process of its own, opened on a recording.

Each viewer gets ports of its own. A viewer that is left over from before listens on the usual ones; a
recording that was sent to it would open among older ones, or in an older version.
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from workcell.errors import InputError, TraceError
from workcell.trace.rerun_viewer import viewer_binary

DATA_PORT, WEB_PORT = 9876, 9090
"""The ports that are taken where they are free: known ones are easier to forward."""
DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")
"""Environment variables of which one names a display on Linux."""
HOST = "127.0.0.1"
"""Reachable from this machine only."""


@dataclass(frozen=True)
class Viewer:
    """A viewer that was started."""

    process: subprocess.Popen[bytes]
    """The caller waits for it or ends it."""
    data_port: int
    """Port it takes recordings on."""
    web_port: int | None
    """Port of its page; None for a window."""

    @property
    def address(self) -> str | None:
        """Where a browser finds the recording; None for a window."""
        if self.web_port is None:
            return None
        source = quote(f"rerun+http://{HOST}:{self.data_port}/proxy", safe="")
        return f"http://{HOST}:{self.web_port}/?url={source}&hide_welcome_screen=1"

    @property
    def ssh_command(self) -> str | None:
        """What forwards both ports from another machine; None for a window."""
        if self.web_port is None:
            return None
        ports = " ".join(f"-L {p}:{HOST}:{p}" for p in (self.web_port, self.data_port))
        return f"ssh -N {ports} {socket.gethostname()}"


def open_viewer(rrd: Path | str, *, web: bool = False) -> Viewer:
    """Starts the viewer on a recording, reachable from this machine only.

    Args:
        rrd: The recording.
        web: Serve it to a browser instead of opening a window.

    Raises:
        TraceError: There is no such recording.
        InputError: A window is wanted and there is no display.
    """
    if not Path(rrd).is_file():
        raise TraceError(f"{rrd}: no such recording")
    if not web and sys.platform == "linux" and not any(map(os.environ.get, DISPLAYS)):
        raise InputError(
            f"there is no display ({', '.join(DISPLAYS)} are not set); --web shows the recording in a browser"
        )
    data_port = free_port(DATA_PORT)
    web_port = free_port(WEB_PORT) if web else None
    command = [str(viewer_binary()), "--bind", HOST, "--port", str(data_port)]
    command.append("--hide-welcome-screen")
    if web:
        command += ["--serve-web", "--web-viewer-port", str(web_port)]
    command.append(str(Path(rrd).resolve()))
    # Its log lines would bury the address, which the caller prints.
    return Viewer(
        subprocess.Popen(command, stdout=subprocess.DEVNULL if web else None),
        data_port,
        web_port,
    )


def free_port(wanted: int) -> int:
    """The wanted port of this machine where nobody listens on it, else any free one."""
    for port in (wanted, 0):
        with socket.socket() as probe:
            try:
                probe.bind((HOST, port))
            except OSError:
                continue
            return int(probe.getsockname()[1])
    raise TraceError(f"no port is free on {HOST}")
