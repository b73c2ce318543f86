"""A film of one run or of several side by side: the cell, a gauge of the time to collision, and curves.

In come traces with their scenes; out comes an mp4, gif or webp at a stated speed. MuJoCo draws the
cell (`stills`), matplotlib the curves once, and every frame adds what moves: the cursor of the curves,
the gauge, the line between the nearest bodies and a few words.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from workcell.errors import InputError, TraceError
from workcell.trace.readings import control_setting, smallest_distance_m
from workcell.trace.table import Trace
from workcell.view.limits import DANGER_MARGIN, FALLBACK_T_MIN_S, TTC_CAP_IN_T_MIN
from workcell.view.palette import COMMANDED, LIMIT, MEASURED, Rgb, arm_colour, unit_rgb
from workcell.view.stills import Lines, frames

FORMATS = (".mp4", ".gif", ".webp")
GREEN, AMBER, RED = (40, 160, 90), (225, 150, 20), (210, 45, 45)
"""Time to collision far from t_min, within twice of it, and at it."""
AMBER_IN_T_MIN = 2.0
MOST_RUNS = 4
"""Runs side by side; with more the cells would be too small to see."""

_PANEL_SHARE = 0.62
"""Width of the gauge and curves in the measure of the cell's height."""
_CELL_SHARE = 1.16
_INK, _FAINT, _PAPER = (32, 36, 42), (120, 126, 134), (252, 252, 252)
_SEEN = 200
"""Positions that the camera is placed by."""
_PROCESSES = 4
"""Drawers at most; each holds the scene's meshes once more."""
_GAUGE_SHARE = 0.2
"""Height of gauge and words above the curves."""


@dataclass(frozen=True)
class Clip:
    """A run and how it is called in the film."""

    trace: Trace
    """The run."""
    scene_xml: Path
    """Its scene."""
    title: str
    """Shown above its gauge."""


def film(
    clips: Sequence[Clip],
    out: Path,
    *,
    speed: float = 1.0,
    fps: int = 20,
    height: int = 480,
    start_s: float = 0.0,
    end_s: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Write a film.

    Args:
        clips: One run or several, side by side on one clock.
        out: File to write; its ending is one of `FORMATS`.
        speed: Seconds of the run in a second of film.
        fps: Pictures a second.
        height: Pixels of a run's picture.
        start_s: Where in the runs the film begins.
        end_s: Where it ends; None is the end of the longest run.
        progress: Called with (pictures drawn, pictures in all) now and then.

    Raises:
        InputError: A value that no film can be made of, or a missing library.
        TraceError: A trace without rows.
        NoPictures: Nothing here can draw.
    """
    ends = [float(clip.trace["time_s"][-1]) if len(clip.trace) else 0.0 for clip in clips]
    end_s = max(ends) if end_s is None else end_s
    _refuse(clips, out, speed, fps, height, start_s, end_s)
    count = max(1, int((end_s - start_s) / speed * fps) + 1)
    times_s = start_s + np.arange(count) * speed / fps
    height -= height % 2  # The usual coding of colours wants even numbers of pixels.
    # Several runs have a process each already.
    processes = max(1, min(_PROCESSES, os.cpu_count() or 1) // len(clips))
    panels = [_Panel(clip, times_s, height, processes=processes) for clip in clips]
    columns = 1 if len(clips) == 1 else 2

    def pictures() -> Iterator[NDArray[np.uint8]]:
        for k, tiles in enumerate(zip(*panels, strict=True), 1):
            yield _tiled(list(tiles), columns)
            if progress and (k % fps == 0 or k == count):
                progress(k, count)

    temporary = out.with_name(f"{out.stem}.part{out.suffix}")
    try:
        if out.suffix == ".mp4":
            _write_mp4(temporary, pictures(), fps)
        else:
            _write_loop(temporary, pictures(), fps)
        os.replace(temporary, out)
    finally:
        temporary.unlink(missing_ok=True)
    return out


def _refuse(
    clips: Sequence[Clip],
    out: Path,
    speed: float,
    fps: int,
    height: int,
    start_s: float,
    end_s: float,
) -> None:
    faults = []
    if not 1 <= len(clips) <= MOST_RUNS:
        faults.append(f"{len(clips)} runs; allowed is 1 to {MOST_RUNS}")
    if out.suffix not in FORMATS:
        faults.append(f"--out {out}: allowed endings are {', '.join(FORMATS)}")
    for name, value, low, high in (
        ("speed", speed, 0.01, 1000.0),
        ("fps", fps, 1, 60),
        ("height", height, 120, 2160),
    ):
        if not low <= value <= high:
            faults.append(f"--{name} {value:g}: allowed is {low:g} to {high:g}")
    if not 0.0 <= start_s < end_s:
        faults.append(f"--start {start_s:g} --end {end_s:g}: allowed is 0 <= start < end")
    if faults:
        raise InputError(faults, file="film")
    for clip in clips:
        if not len(clip.trace):
            raise TraceError(f"{clip.trace.source}: has no rows to show")
        if not clip.scene_xml.is_file():
            raise TraceError(f"{clip.scene_xml}: no such scene")


def gauge_colour(ttc_s: float, t_min_s: float) -> Rgb:
    """Green, amber or red for a time to collision; NaN, where nothing closes, is green."""
    if np.isnan(ttc_s) or ttc_s > AMBER_IN_T_MIN * t_min_s:
        return GREEN
    return RED if ttc_s < DANGER_MARGIN * t_min_s else AMBER


class _Panel:
    """The pictures of one run, (height, width, 3) each: its cell, and beside it gauge and curves."""

    def __init__(
        self, clip: Clip, times_s: NDArray[np.float64], height: int, *, processes: int = 1
    ):
        trace = clip.trace
        self._clip, self._times_s, self._height = clip, times_s, height
        self._processes = processes
        self._rows = np.clip(np.searchsorted(trace["time_s"], times_s - 1e-9), 0, len(trace) - 1)
        self._t_min_s = control_setting(trace, "t_min_s") or FALLBACK_T_MIN_S
        self._ttc_s = trace["ttc_s"][self._rows]
        self._distance_m = smallest_distance_m(trace)[self._rows]
        self._modes = {arm: trace[f"{arm}.mode"][self._rows] for arm in trace.layout.arms}
        self._width = 2 * round(_PANEL_SHARE * height / 2)
        self._gauge_px = round(_GAUGE_SHARE * height)
        self._paper, self._left, self._right = self._curves()
        size = max(7, round(height / 36))
        self._font = ImageFont.load_default(size)
        self._large = ImageFont.load_default(round(1.6 * size))

    def __iter__(self) -> Iterator[NDArray[np.uint8]]:
        trace = self._clip.trace
        ends = np.stack([trace.part(f"witness_{e}_m", self._rows) for e in "ij"], axis=1)
        rgb = np.array([unit_rgb(gauge_colour(t, self._t_min_s)) for t in self._ttc_s])
        qpos = trace.part("qpos", self._rows)
        seen = qpos[:: max(1, len(qpos) // _SEEN)]
        # Each process draws every second picture, or third, ...; they are taken in turn.
        drawers = [
            frames(
                self._clip.scene_xml, qpos[k :: self._processes],
                width=2 * round(_CELL_SHARE * self._height / 2), height=self._height,
                arms=trace.layout.arms, draft=True, seen_qpos=seen,
                lines=Lines(ends[k :: self._processes], rgb[k :: self._processes]),
            )
            for k in range(min(self._processes, len(qpos)))
        ]  # fmt: skip
        for k in range(len(qpos)):
            cell = next(drawers[k % len(drawers)])
            yield np.concatenate([cell, self._panel(k)], axis=1)

    def _curves(self) -> tuple[NDArray[np.uint8], float, float]:
        """The curves of the whole film, and the pixels at which their time begins and ends."""
        trace, dpi = self._clip.trace, 100
        height = self._height - self._gauge_px
        figure = Figure(
            figsize=(self._width / dpi, height / dpi),
            dpi=dpi,
            facecolor=(_PAPER[0] / 255, _PAPER[1] / 255, _PAPER[2] / 255),
        )
        canvas = FigureCanvasAgg(figure)
        time_s = trace["time_s"]
        cap_s = TTC_CAP_IN_T_MIN * self._t_min_s
        panels = figure.subplots(3, 1, sharex=True)
        figure.subplots_adjust(left=0.16, right=0.96, top=0.95, bottom=0.09, hspace=0.32)
        ttc, distance, speed = panels
        ttc.plot(
            time_s, np.minimum(trace["ttc_command_s"], cap_s), color=unit_rgb(COMMANDED), lw=0.8
        )
        ttc.plot(time_s, np.minimum(trace["ttc_s"], cap_s), color=unit_rgb(MEASURED), lw=1.2)
        ttc.axhline(self._t_min_s, color=unit_rgb(LIMIT), lw=0.8)
        ttc.set_ylim(0, cap_s)
        distance.plot(time_s, smallest_distance_m(trace), color=unit_rgb(MEASURED), lw=1.2)
        for index, arm in enumerate(trace.layout.arms):
            speed.plot(
                time_s, trace[f"{arm}.tool_speed_m_s"], color=unit_rgb(arm_colour(index)), lw=1.0
            )
        titles = ("time to collision [s]", "smallest distance [m]", "tool speed [m/s]")
        for axes, title in zip(panels, titles, strict=True):
            axes.set_title(title, fontsize=8, loc="left", pad=3)
            axes.tick_params(labelsize=7)
            axes.grid(alpha=0.25)
            axes.set_xlim(self._times_s[0], max(self._times_s[-1], self._times_s[0] + 1e-3))
        canvas.draw()
        box = speed.get_window_extent()
        picture = np.asarray(canvas.buffer_rgba())[..., :3]
        return picture[:height, : self._width].copy(), box.x0, box.x1

    def _panel(self, k: int) -> NDArray[np.uint8]:
        time_s, ttc_s = float(self._times_s[k]), float(self._ttc_s[k])
        picture = Image.new("RGB", (self._width, self._height), _PAPER)
        picture.paste(Image.fromarray(self._paper), (0, self._gauge_px))
        draw = ImageDraw.Draw(picture)
        pad = round(0.04 * self._width)
        line = self._font.size * 1.25
        draw.text((pad, pad / 2), self._clip.title, _INK, self._font)
        draw.text((self._width - pad, pad / 2), f"{time_s:.1f} s", _INK, self._font, anchor="ra")
        colour = gauge_colour(ttc_s, self._t_min_s)
        number = "–" if np.isnan(ttc_s) or ttc_s > 99 else f"{ttc_s:.2f} s"
        top = pad / 2 + 1.15 * line
        draw.text((pad, top), number, colour, self._large)
        left, right = pad + 4.6 * self._large.size, self._width - pad
        middle, half = top + 0.62 * self._large.size, 0.22 * self._large.size
        draw.rectangle((left, middle - half, right, middle + half), outline=_FAINT)
        # The bar is full at t_min: it shows how much of the room is used up.
        share = 0.0 if np.isnan(ttc_s) else min(1.0, self._t_min_s / max(ttc_s, 1e-9))
        if share > 0:
            draw.rectangle(
                (left, middle - half, left + share * (right - left), middle + half), colour
            )
        modes = "   ".join(f"{arm}: {mode[k]}" for arm, mode in self._modes.items())
        gap_m = self._distance_m[k]
        words = (
            modes
            if len(self._modes) > 2 or not np.isfinite(gap_m)
            else f"{modes}   {1e3 * gap_m:.0f} mm"
        )
        draw.text((pad, top + 1.35 * self._large.size), words, _FAINT, self._font)
        span_s = max(float(self._times_s[-1] - self._times_s[0]), 1e-3)
        x = self._left + (self._right - self._left) * (time_s - self._times_s[0]) / span_s
        draw.line((x, self._gauge_px, x, self._height - 0.05 * self._height), _FAINT, 1)
        return np.asarray(picture)


def _tiled(tiles: list[NDArray[np.uint8]], columns: int) -> NDArray[np.uint8]:
    """Pictures in rows of so many; a place without one is paper."""
    blank = np.full_like(tiles[0], _PAPER[0])
    tiles = tiles + [blank] * (-len(tiles) % columns)
    rows = [np.concatenate(tiles[k : k + columns], axis=1) for k in range(0, len(tiles), columns)]
    return np.concatenate(rows)


def _write_mp4(path: Path, pictures: Iterator[NDArray[np.uint8]], fps: int) -> None:
    try:
        import imageio_ffmpeg
    except ImportError as error:
        raise InputError(
            "film: mp4 needs imageio-ffmpeg; install it with: pip install 'ttc-workcell[film]', "
            "or choose --out with .webp or .gif"
        ) from error
    writer = None
    try:
        for picture in pictures:
            if writer is None:
                height, width, _ = picture.shape
                writer = imageio_ffmpeg.write_frames(
                    str(path), (width, height), fps=fps, codec="libx264", quality=7,
                    macro_block_size=2, output_params=["-preset", "veryfast"],
                )  # fmt: skip
                writer.send(None)
            writer.send(np.ascontiguousarray(picture).tobytes())
    finally:
        if writer is not None:
            writer.close()


def _write_loop(path: Path, pictures: Iterator[NDArray[np.uint8]], fps: int) -> None:
    """A film without end, as pages show it: webp, or gif with a palette of its own."""
    images = (Image.fromarray(picture) for picture in pictures)
    options: dict[str, Any] = (
        {"quality": 62, "method": 4} if path.suffix == ".webp" else {"optimize": True}
    )
    if path.suffix == ".gif":
        first = next(images).quantize(128, dither=Image.Dither.NONE)
        rest = (image.quantize(palette=first, dither=Image.Dither.NONE) for image in images)
    else:
        first, rest = next(images), images
    first.save(
        path, save_all=True, append_images=rest, duration=round(1000 / fps), loop=0, **options
    )
