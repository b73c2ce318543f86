"""A trace as a recording for the rerun viewer, with its own layout of views.

In come a trace and its scene; out comes one `.rrd` file that opens with the cell in 3D, the curves
beside it and the events below. It is derived, never the source of a number: it can be made again
from the trace at any time, and `is_current` tells when it should be. Its parts are `geometry`,
`curves` and `events`, laid out by `blueprint`.
"""

from __future__ import annotations

import os
import uuid
import warnings
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import mujoco
import rerun as rr
from rerun.chunk import RrdReader
from rerun.error_utils import RerunWarning

from workcell.errors import TraceError
from workcell.files import require_files
from workcell.trace.table import Trace
from workcell.view.blueprint import layout
from workcell.view.curves import log_curves
from workcell.view.events import log_modes
from workcell.view.frames import Frames
from workcell.view.geometry import log_geometry
from workcell.view.trails import log_trails
from workcell.view.verdict import headline, markdown

VIEW_VERSION = 2
"""Raised when a recording made by this file should look different from older ones."""

_APPLICATION = "workcell"


def record(
    trace: Trace,
    scene_xml: Path | str,
    out_rrd: Path | str,
    *,
    summary: Mapping[str, Any] | None = None,
) -> Path:
    """Derives the recording of a run.

    Args:
        trace: The run.
        scene_xml: Its scene.
        out_rrd: File to write; it appears whole or not at all.
        summary: Its summary, for the page with the verdict; None where the run has none.

    Returns:
        The path written.

    Raises:
        TraceError: The trace is empty or belongs to another scene.
    """
    model = _load_scene(trace, scene_xml)
    out_rrd = Path(out_rrd)
    temporary = out_rrd.with_name(out_rrd.name + ".part")
    rr.set_strict_mode(True)
    recording = rr.RecordingStream(
        _APPLICATION, recording_id=str(uuid.uuid4()), send_properties=False
    )
    # A clock's time would only blur what is simulated.
    recording.set_log_time_enabled(False)
    recording.set_log_tick_enabled(False)
    recording.save(temporary)
    try:
        frames = Frames(trace, model)
        recording.send_blueprint(layout(trace, frames))
        recording.send_recording_name(_title(trace, out_rrd))
        recording.send_property(
            "workcell", rr.AnyValues(drop_untyped_nones=True, **_origin(trace, summary))
        )
        log_geometry(recording, trace, model, frames)
        log_curves(recording, trace)
        log_modes(recording, trace)
        log_trails(recording, trace, frames.rows)
        text = "This run has no summary." if summary is None else markdown(summary)
        recording.log(
            "verdict", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True
        )
        recording.flush()
    finally:
        recording.disconnect()
    os.replace(temporary, out_rrd)
    return out_rrd


def is_current(rrd: Path | str, trace: Trace, *, summary: Mapping[str, Any] | None = None) -> bool:
    """Whether the recording was made of this trace and verdict, by these versions of rerun and this file.

    A recording that is missing or cannot be read is not current.
    """
    if not Path(rrd).is_file():
        return False
    found = {}
    try:
        with warnings.catch_warnings():
            # A file without its end is reported twice: here, and by the error that follows.
            warnings.simplefilter("ignore", RerunWarning)
            store = RrdReader(str(rrd)).store()
        for chunk in store.stream().filter(content="/__properties/workcell"):
            batch = chunk.to_record_batch()
            for name, values in zip(batch.schema.names, batch.columns, strict=True):
                found[name] = values[0].as_py()
    except RuntimeError:  # The reader has no narrower one.
        return False
    return all(found.get(key) == [value] for key, value in _origin(trace, summary).items())


def _load_scene(trace: Trace, scene_xml: Path | str) -> mujoco.MjModel:
    if not len(trace):
        raise TraceError(f"{trace.source}: has no rows to show")
    try:
        require_files(Path(scene_xml).parent)
        model = mujoco.MjModel.from_xml_path(str(scene_xml))
    except (OSError, ValueError) as error:
        raise TraceError(f"{scene_xml}: is no scene: {error}") from error
    if model.nq != trace.layout.nq:
        raise TraceError(
            f"{trace.source}: has {trace.layout.nq} coordinates, {scene_xml} has {model.nq}"
        )
    return model


def _origin(trace: Trace, summary: Mapping[str, Any] | None) -> dict[str, str]:
    """What a recording depends on."""
    return {
        "rerun": version("rerun-sdk"),
        "view": str(VIEW_VERSION),
        "trace_sha256": trace.digest(),
        "verdict": "none" if summary is None else headline(summary),
        "scenario": str(trace.metadata.get("scenario", "")),
    }


def _title(trace: Trace, out_rrd: Path) -> str:
    return str(trace.metadata.get("settings", {}).get("name", out_rrd.parent.name))
