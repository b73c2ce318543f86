"""The real thing: `workcell teleop` under a virtual display, with a real mouse and real keys."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from tests.live.browser import pixel
from workcell import run as runner
from workcell import scenario
from workcell.errors import InputError, TraceError
from workcell.live import display as module
from workcell.live.camera import best_view
from workcell.live.devices import KEY_SPEED_M_S
from workcell.live.sitting import home
from workcell.trace.table import Trace, load

MISSING = [tool for tool in ("Xvfb", "xdotool") if shutil.which(tool) is None]
needs_display = pytest.mark.skipif(
    bool(MISSING) and os.environ.get("WORKCELL_CI") != "1",
    reason=f"needs a virtual display and synthetic events: {', '.join(MISSING)} not installed",
)
PATIENCE_S = 60.0
"""Software rendering on a loaded machine takes seconds to open a window."""


class Live(NamedTuple):
    folder: Path
    said: str
    status: int
    dragged_m: np.ndarray
    """Where the mouse had left the target."""

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

    def picture(self, file: Path) -> None:
        """What is on the screen, for somebody who looks."""
        if shutil.which("import"):
            subprocess.run(["import", "-window", "root", str(file)], env=self.env, timeout=30)

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


SETTINGS = (
    "arm.surgeon.operator.kind=live",
    "simulation.plant=kinematic",
    "simulation.period_s=0.02",
    "check.enabled=false",  # its deadline is not for a machine that draws with the processor
    "arm.surgeon.operator.stale_s=2.0",
)


def marker_pixel(width: int, height: int) -> tuple[int, int]:
    """Where the surgeon's marker is in a window of this size, with the camera as it starts."""
    with tempfile.TemporaryDirectory() as folder:
        cell = runner.prepare(scenario.load("handover", SETTINGS), Path(folder))
    data = home(cell)
    view = best_view(cell, data, cell.scenario.view)
    surgeon = next(arm for arm in cell.arms if arm.name == "surgeon")
    fov = np.radians(cell.model.vis.global_.fovy)
    x, y = pixel(view, data.site_xpos[surgeon.tool_site], width=width, height=height, fov_rad=fov)
    return round(x), round(y)


@pytest.fixture(scope="module")
def live(tmp_path_factory) -> Live:
    """One session in the shipped scene: drag with the mouse, hold a key, change t_min and the criterion, leave."""
    folder = tmp_path_factory.mktemp("live")
    out = folder / "run"
    desk = Desk()
    settings = [part for setting in SETTINGS for part in ("--set", setting)]
    command = [
        sys.executable,
        "-m",
        "workcell",
        "teleop",
        "handover",
        "--window",
        "--out",
        str(out),
    ]
    process = subprocess.Popen(
        [*command, *settings],
        env=desk.env,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
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
        desk.picture(folder / "start.png")
        desk.do("mousemove", "--window", window, *marker_pixel(width, height))
        desk.do("click", "--repeat", 2, "--delay", 40, 1)
        time.sleep(1.0)
        desk.do("keydown", "ctrl")
        desk.do("mousedown", 3)
        for _ in range(8):
            desk.do("mousemove_relative", "--", 6, 0)
        desk.do("mouseup", 3)
        desk.do("keyup", "ctrl")
        time.sleep(2.0)
        dragged = load(out)["surgeon.target_position_m"][-1]
        desk.do("key", "7")  # any key: from the first on, the keyboard is the session's
        desk.do("keydown", "Prior")
        time.sleep(1.0)
        desk.do("keyup", "Prior")
        time.sleep(1.5)
        desk.do("key", "8")
        time.sleep(1.0)
        desk.picture(folder / "end.png")
        desk.do("key", "9")
        said, _ = process.communicate(timeout=PATIENCE_S)
    finally:
        if process.poll() is None:
            process.kill()
            process.wait(10)
        desk.close()
    return Live(out, said, process.returncode, dragged)


@needs_display
def test_a_session_ends_well_and_leaves_a_run_folder(live):
    assert live.status == 0, live.said
    names = {path.name for path in live.folder.iterdir()}
    assert {
        "scenario.toml", "scene", "trace.parquet", "recording.rrd", "summary.json",
        "operator_surgeon.csv", "replay.toml",
    } <= names  # fmt: skip


@needs_display
@pytest.mark.long  # a drag in real time, which a second worker on the same cores spoils
def test_the_marker_is_grabbed_where_it_is_seen(live):
    assert np.linalg.norm(live.dragged_m - live.trace["surgeon.target_position_m"][0]) > 0.03


@needs_display
def test_a_held_key_moves_the_target_at_its_speed_and_only_where_it_says(live):
    way = live.trace["surgeon.target_position_m"][-1] - live.dragged_m
    assert way[:2] == pytest.approx([0.0, 0.0], abs=0.005)
    # A second, and a quarter of one in which the key's own process ends.
    assert 0.8 * KEY_SPEED_M_S < way[2] < 2.0 * KEY_SPEED_M_S


@needs_display
def test_the_target_never_leaps(live):
    dt = 0.02
    velocity = np.diff(live.trace["surgeon.target_position_m"], axis=0) / dt
    assert np.linalg.norm(velocity, axis=1).max() <= 0.5 * 1.001


@needs_display
def test_parameters_changed_by_key_are_logged(live):
    trace = live.trace
    assert (trace["t_min_s"][0], trace["t_min_s"][-1]) == (1.0, pytest.approx(1.1))
    assert (trace["criterion"][0], trace["criterion"][-1]) == ("artc", "artc_approaching")
    assert "t_min_s = 1.1" in live.said
    assert "criterion = artc_approaching" in live.said


@needs_display
def test_late_ticks_are_reported(live):
    kept = json.loads((live.folder / "summary.json").read_text())["real_time"]
    assert kept["ticks"] >= len(live.trace)
    assert "expectation" not in live.said
    assert 0 <= kept["missed"] <= kept["ticks"]
    assert kept["frames"] > 10
    assert f"{kept['missed']} of {kept['ticks']} ticks came late" in live.said


@needs_display
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


def test_without_a_display_the_window_is_refused_and_the_page_is_named():
    env = {name: value for name, value in os.environ.items() if "DISPLAY" not in name}
    command = [sys.executable, "-m", "workcell", "teleop", "handover", "--window"]
    done = subprocess.run(
        [*command, "--set", "arm.surgeon.operator.kind=live"],
        env=env,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    assert done.returncode == 2, done.stderr
    assert "there is no display" in done.stderr
    assert "mjpython" in done.stderr
    assert "the page in a browser needs no display" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_display_that_does_not_answer_is_named(monkeypatch):
    monkeypatch.setenv("DISPLAY", ":4711")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(InputError, match="the display ':4711' cannot be used"):
        module.require_display()


def test_on_a_mac_the_window_needs_mjpython(monkeypatch):
    monkeypatch.setattr(module.sys, "platform", "darwin")
    with pytest.raises(InputError, match=r"mjpython -m workcell teleop .* --window; .*page"):
        module.require_display()
