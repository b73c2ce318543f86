"""The rerun viewer as a process of its own, opened on a recording."""

from __future__ import annotations

import subprocess
from pathlib import Path

from workcell.errors import TraceError
from workcell.trace.rerun_viewer import viewer_binary


def open_viewer(rrd: Path | str, *, web: bool = False) -> subprocess.Popen[bytes]:
    """Starts the viewer on a recording, reachable from this machine only.

    Args:
        rrd: The recording.
        web: Serve it to a browser instead of opening a window.

    Returns:
        The viewer's process; the caller waits for it or ends it.
    """
    if not Path(rrd).is_file():
        raise TraceError(f"{rrd}: no such recording")
    command = [str(viewer_binary()), "--bind", "127.0.0.1", "--hide-welcome-screen"]
    if web:
        command.append("--serve-web")
    return subprocess.Popen([*command, str(Path(rrd).resolve())])
