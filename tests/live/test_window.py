"""The real thing: `workcell teleop` under a virtual display, with a real mouse and real keys."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from tests import cells
from workcell import run as runner
from workcell import scenario
from workcell.errors import TraceError
from workcell.trace.table import Trace, load

MISSING = [tool for tool in ("Xvfb", "xdotool") if shutil.which(tool) is None]
pytestmark = pytest.mark.skipif(
    bool(MISSING) and os.environ.get("WORKCELL_CI") != "1",
    reason=f"needs a virtual display and synthetic events: {', '.join(MISSING)} not installed",
)
PATIENCE_S = 60.0
"""Software rendering on a loaded machine takes seconds to open a window."""


class Live(NamedTuple):
    folder: Path
    said: str
    status: int

    @property
    def trace(self) -> Trace:
        return load(self.folder)


class Desk:
    """A virtual display with a mouse and a keyboard."""

    def __init__(self):
        read, write = os.pipe()
        self._server = subprocess.Popen(
            ["Xvfb", "-displayfd", str(write), "-screen", "0", "1024x768x24"],
            pass_fds=[write],
            stderr=subprocess.DEVNULL,
        )
        os.close(write)
        with os.fdopen(read) as number:
            self.display = f":{number.readline().strip()}"
        self.env = os.environ | {"DISPLAY": self.display, "MUJOCO_GL": "glfw"}

    def do(self, *words: object) -> str:
        command = ["xdotool", *(str(word) for word in words)]
        done = subprocess.run(command, env=self.env, capture_output=True, text=True, timeout=30)
        time.sleep(0.25)  # a frame of a slow renderer, in which the viewer looks for events
        return done.stdout.strip()

    def window(self, process: subprocess.Popen) -> str:
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline and process.poll() is None:
            found = self.do("search", "--name", "MuJoCo").splitlines()
            if found:
                return found[0]
        raise TimeoutError("the viewer's window did not open")

    def close(self):
        self._server.terminate()
        self._server.wait(10)


def wait_for_rows(folder: Path, rows: int, process: subprocess.Popen) -> None:
    """Until the run has got somewhere, seen in its journal."""
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline and process.poll() is None:
        with contextlib.suppress(TraceError):  # not begun yet
            if len(load(folder)) >= rows:
                return
        time.sleep(0.2)
    raise TimeoutError("the run does not get on")


@pytest.fixture(scope="module")
def live(tmp_path_factory) -> Live:
    """One session: steer with keys, drag with the mouse, change t_min and the criterion, leave."""
    folder = tmp_path_factory.mktemp("live")
    content = cells.duet()
    content["simulation"] |= {"duration_s": 120.0, "period_s": 0.01}
    content["check"] = {"enabled": False}
    # A loaded machine draws slowly: there a gap of half a second between frames is no fault.
    content["arm"][0]["operator"] = {"kind": "live", "stale_s": 2.0, "late_s": 2.0}
    file, out = cells.write(folder, content), folder / "run"
    desk = Desk()
    command = [sys.executable, "-m", "workcell", "teleop", str(file), "--out", str(out)]
    process = subprocess.Popen(
        command, env=desk.env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    try:
        window = desk.window(process)
        wait_for_rows(out, 50, process)
        desk.do("windowfocus", window)
        width, height = (
            int(line.partition("=")[2])
            for line in desk.do("getwindowgeometry", "--shell", window).splitlines()
            if line.startswith(("WIDTH", "HEIGHT"))
        )
        # The camera looks at the marker: it is in the middle of the window.
        desk.do("mousemove", "--window", window, width // 2, height // 2)
        desk.do("click", "--repeat", 2, "--delay", 40, 1)
        time.sleep(1.0)
        desk.do("keydown", "ctrl")
        desk.do("mousedown", 3)
        for _ in range(6):
            desk.do("mousemove_relative", "--", 6, 0)
        desk.do("mouseup", 3)
        desk.do("keyup", "ctrl")
        time.sleep(1.0)
        for key in ("Right", "Up", "Up", "7", "8"):
            desk.do("key", key)
        time.sleep(2.0)
        desk.do("key", "9")
        said, _ = process.communicate(timeout=PATIENCE_S)
    finally:
        if process.poll() is None:
            process.kill()
            process.wait(10)
        desk.close()
    return Live(out, said, process.returncode)


def test_a_session_ends_well_and_leaves_a_run_folder(live):
    assert live.status == 0, live.said
    names = {path.name for path in live.folder.iterdir()}
    assert {
        "scenario.toml", "scene", "trace.parquet", "recording.rrd", "summary.json",
        "operator_surgeon.csv", "replay.toml",
    } <= names  # fmt: skip


def test_mouse_and_keys_move_the_target(live):
    target = live.trace["surgeon.target_position_m"]
    way = target[-1] - target[0]
    assert way[0] > 0.05  # dragged to the right by the mouse, a centimetre of it by a key
    assert way[1] == pytest.approx(0.02, abs=0.015)  # two keys up


def test_the_target_never_leaps(live):
    dt = 0.01
    velocity = np.diff(live.trace["surgeon.target_position_m"], axis=0) / dt
    assert np.linalg.norm(velocity, axis=1).max() <= 0.5 * 1.001


def test_parameters_changed_by_key_are_logged(live):
    trace = live.trace
    assert (trace["t_min_s"][0], trace["t_min_s"][-1]) == (1.0, pytest.approx(1.1))
    assert (trace["criterion"][0], trace["criterion"][-1]) == ("artc", "artc_approaching")
    assert "t_min_s = 1.1" in live.said
    assert "criterion = artc_approaching" in live.said


def test_late_ticks_are_reported(live):
    kept = json.loads((live.folder / "summary.json").read_text())["real_time"]
    assert kept["ticks"] >= len(live.trace)
    assert 0 <= kept["missed"] <= kept["ticks"]
    assert kept["frames"] > 10
    assert f"{kept['missed']} of {kept['ticks']} ticks came late" in live.said


def test_a_recorded_live_run_replays_to_the_same_bits(live, tmp_path):
    again = runner.run(scenario.load(live.folder / "replay.toml"), tmp_path)
    assert again["metrics"]["fault"] is None
    first, second = live.trace, load(tmp_path)
    assert len(first) == len(second)
    for name in first.table.column_names:
        if not name.endswith((".job", ".operator_state")):
            assert first[name].tobytes() == second[name].tobytes() or np.array_equal(
                first[name], second[name], equal_nan=first[name].dtype.kind == "f"
            ), name
