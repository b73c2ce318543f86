"""A real browser at the live page, and the page's geometry: where in its picture a point of the cell is."""

from __future__ import annotations

import contextlib
import math
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests import cells
from workcell.errors import TraceError
from workcell.live.camera import FIELD_OF_VIEW_RAD, CameraView
from workcell.trace.table import load

CHROMIUM = next(
    (
        found
        for name in ("chromium", "chromium-browser", "google-chrome")
        if (found := shutil.which(name))
    ),
    None,
)
try:
    from playwright.sync_api import Page, sync_playwright
except ImportError:
    sync_playwright = None
MISSING = [
    name for name, there in (("chromium", CHROMIUM), ("playwright", sync_playwright)) if not there
]
needs_browser = pytest.mark.skipif(
    bool(MISSING) and os.environ.get("WORKCELL_CI") != "1",
    reason=f"needs a browser and something to drive it: {', '.join(MISSING)} not installed",
)
PATIENCE_MS = 240_000
"""A loaded machine without a GPU takes its time to draw a page."""
WIDTH, HEIGHT = 1000, 640
_SEEN_KEYS = "window.seen = {}; for (const kind of ['keydown', 'keyup']) window.addEventListener(kind, () => { window.seen[kind] ??= performance.now(); }, true);"
"""Before the page's own script, which lets no key event pass."""


def duet_toml(folder: Path, **simulation) -> Path:
    """Two planar arms, one of them a person's; no final check, whose deadline a loaded machine breaks."""
    content = cells.duet()
    content["simulation"] |= {"duration_s": 600.0, "period_s": 0.01} | simulation
    content["check"] = {"enabled": False}
    content["arm"][0]["operator"] = {"kind": "live"}
    return cells.write(folder, content)


class Served:
    """`workcell teleop` in a process of its own, serving a page."""

    def __init__(self, scenario: str | Path, out: Path, *options: str):
        command = [sys.executable, "-m", "workcell", "teleop", str(scenario), "--out", str(out)]
        self.folder = out
        self.process = subprocess.Popen(
            [*command, "--port", "0", *options],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self.said: list[str] = []
        self.address = self._address()

    def _address(self) -> str:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.said.append(line)
            found = re.search(r"http://\S+", line)
            if found:
                return found.group(0)
        raise AssertionError("".join(self.said))

    def end(self) -> int:
        """Wait for the end; returns the exit status."""
        said, _ = self.process.communicate(timeout=PATIENCE_MS / 1000)
        self.said.append(said)
        return self.process.returncode

    def rows(self) -> int:
        """Ticks written so far."""
        with contextlib.suppress(TraceError):
            return len(load(self.folder))
        return 0


@contextlib.contextmanager
def served(scenario: str | Path, out: Path, *options: str) -> Iterator[Served]:
    run = Served(scenario, out, *options)
    try:
        yield run
    finally:
        if run.process.poll() is None:
            run.process.kill()
            run.process.wait(10)


@contextlib.contextmanager
def browser() -> Iterator:
    """A browser that draws with the processor."""
    flags = [
        "--no-sandbox",
        "--use-gl=angle",
        "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader",
    ]
    with sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=CHROMIUM, args=flags)
        try:
            yield opened
        finally:
            opened.close()


def open_page(opened, address: str, *, width: int = WIDTH, height: int = HEIGHT) -> Page:
    """A page in a browser profile of its own, drawn and connected."""
    context = opened.new_context(viewport={"width": width, "height": height})
    context.add_init_script(_SEEN_KEYS)
    page = context.new_page()
    page.set_default_timeout(PATIENCE_MS)
    page.on("pageerror", lambda error: pytest.fail(f"the page's script failed: {error}"))
    page.goto(address)
    page.wait_for_selector("#wc-side button")
    page.wait_for_selector("#root canvas")
    return page


def phase(page: Page, name: str) -> None:
    """Wait for a phase of the run."""
    page.wait_for_selector(f"#wc[data-phase={name}]", state="attached")


def start(page: Page) -> None:
    """Start the run, through its count."""
    page.click("#wc-start")
    phase(page, "running")


def hold(page: Page, key: str, time_s: float) -> float:
    """Hold a key; returns how long the page saw it held."""
    page.evaluate("() => { window.seen = {}; }")
    page.keyboard.down(key)
    time.sleep(time_s)
    page.keyboard.up(key)
    return page.evaluate("() => (window.seen.keyup - window.seen.keydown) / 1000")


def pixel(
    view: CameraView,
    point_m,
    *,
    width: int = WIDTH,
    height: int = HEIGHT,
    fov_rad: float = FIELD_OF_VIEW_RAD,
) -> tuple[float, float]:
    """Where a point of the cell is in a picture of it."""
    ahead = view.look_at_m - view.position_m
    ahead = ahead / np.linalg.norm(ahead)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, ahead)
    way = np.asarray(point_m) - view.position_m
    scale = height / 2.0 / math.tan(fov_rad / 2.0) / float(way @ ahead)
    return width / 2.0 + scale * float(way @ right), height / 2.0 - scale * float(way @ up)


def drag(page: Page, start_px, end_px, *, steps: int = 6) -> None:
    """Drag with the left button, as slowly as the picture follows."""
    page.mouse.move(*start_px)
    time.sleep(0.6)  # a frame in which what is under the mouse is found
    page.mouse.down()
    for k in range(1, steps + 1):
        share = k / steps
        page.mouse.move(*(a + share * (b - a) for a, b in zip(start_px, end_px, strict=True)))
        time.sleep(0.15)


def until(condition, limit_s: float = PATIENCE_MS / 1000) -> bool:
    """Whether something comes true in time."""
    end_s = time.monotonic() + limit_s
    while time.monotonic() < end_s:
        if condition():
            return True
        time.sleep(0.1)
    return condition()
