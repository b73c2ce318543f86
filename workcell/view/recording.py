"""A trace as a recording for the rerun viewer, with its own layout of views.

In come a trace and its scene; out comes one `.rrd` file that opens with the cell in 3D, the curves
beside it and the events below. It is derived, never the source of a number: it can be made again
from the trace at any time, and `is_current` tells when it should be. The only file that knows
rerun.
"""

from __future__ import annotations

import os
import subprocess
import uuid
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray
from rerun.chunk import RrdReader
from rerun.error_utils import RerunWarning

from workcell.errors import TraceError
from workcell.trace.readings import control_setting, period_s, smallest_distance_m
from workcell.trace.rerun_viewer import viewer_binary
from workcell.trace.table import Trace
from workcell.view.palette import (
    CLOSEST,
    COMMANDED,
    DANGER,
    LIMIT,
    MEASURED,
    MODE_COLOURS,
    OTHER_MODE,
    Rgb,
    arm_colour,
)
from workcell.view.scene3d import geom_triangles, joined

VIEW_VERSION = 1
"""Raised when a recording made by this file should look different from older ones."""

WATCHED_GROUP = 4
"""Geom group of the watched capsules."""
DRAWN_GROUPS = (0, 1, 2)
"""Geom groups that are drawn as they are: those MuJoCo's own viewer shows."""
GEOMETRY_PERIOD_S = 0.02
"""Chosen for fluent motion at a tenth of the data: screens redraw at 60 Hz."""
TTC_CAP_IN_T_MIN = 5.0
"""Plots end at this multiple of t_min: beyond it nothing acts, and curves jump to infinity."""
DANGER_MARGIN = 1.05
"""The witness line is red below this multiple of t_min: scaling holds t at t_min, not below it."""

_APPLICATION = "workcell"
_CHUNK_ROWS = 4096
_FRAME_BLOCK = 512
"""Instants whose poses are held in double precision; chosen for a few megabytes."""
_CAPSULE_ALPHA = 110
_FALLBACK_T_MIN_S = 1.0
"""Only scales the axis of a trace that carries no t_min."""

VIEW_NAMES = (
    "Cell", "Events", "Time to collision [s]", "Smallest distance [m]", "ARTC [1/s]",
    "Tool speed [m/s]", "Scale", "Mode",
)  # fmt: skip


def record(trace: Trace, scene_xml: Path | str, out_rrd: Path | str) -> Path:
    """Derives the recording of a run.

    Args:
        trace: The run.
        scene_xml: Its scene.
        out_rrd: File to write; it appears whole or not at all.

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
        frames = _Frames(trace, model)
        recording.send_blueprint(_layout(trace, frames))
        recording.send_recording_name(_title(trace, out_rrd))
        recording.send_property("workcell", rr.AnyValues(drop_untyped_nones=True, **_origin(trace)))
        _log_geometry(recording, trace, model, frames)
        _log_curves(recording, trace)
        _log_modes(recording, trace)
        recording.flush()
    finally:
        recording.disconnect()
    os.replace(temporary, out_rrd)
    return out_rrd


def is_current(rrd: Path | str, trace: Trace) -> bool:
    """Whether the recording was made of this trace by these versions of rerun and of this file.

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
    return all(found.get(key) == [value] for key, value in _origin(trace).items())


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


class _Frames:
    """Poses of all that moves at the instants that are drawn.

    Kept as they are sent, in single precision, and only of what is drawn: a run of ten minutes has
    thirty thousand instants.
    """

    def __init__(self, trace: Trace, model: mujoco.MjModel):
        every = max(1, round(GEOMETRY_PERIOD_S / period_s(trace))) if len(trace) > 1 else 1
        self.rows = np.arange(0, len(trace), every)
        """Rows of the trace that are drawn, (K,)."""
        qpos = trace.part("qpos", self.rows)
        bodies = np.array(sorted({int(model.geom_bodyid[g]) for g in range(model.ngeom)}))
        capsules = np.flatnonzero([_is_watched(model, g) for g in range(model.ngeom)])
        self._body_place = {body: k for k, body in enumerate(bodies.tolist())}
        self._capsule_place = {geom: k for k, geom in enumerate(capsules.tolist())}
        count = len(qpos)
        self._body_m = np.empty((len(bodies), count, 3), np.float32)
        self._body_xyzw = np.empty((len(bodies), count, 4), np.float32)
        self._capsule_m = np.empty((count, len(capsules), 3), np.float32)
        self._capsule_xyzw = np.empty((count, len(capsules), 4), np.float32)
        moving = np.flatnonzero(model.body_weldid[model.geom_bodyid] != 0)
        corners = moving if len(moving) else np.arange(model.ngeom)
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        data = mujoco.MjData(model)
        for start in range(0, count, _FRAME_BLOCK):
            block = slice(start, start + _FRAME_BLOCK)
            some = qpos[block]
            position_m, wxyz = (
                np.empty((len(some), model.nbody, 3)),
                np.empty((len(some), model.nbody, 4)),
            )
            geom_m, geom_xmat = (
                np.empty((len(some), model.ngeom, 3)),
                np.empty((len(some), model.ngeom, 9)),
            )
            for k, q in enumerate(some):
                data.qpos[:] = q
                mujoco.mj_kinematics(model, data)
                position_m[k], wxyz[k] = data.xpos, data.xquat
                geom_m[k], geom_xmat[k] = data.geom_xpos, data.geom_xmat
            self._body_m[:, block] = position_m[:, bodies].swapaxes(0, 1)
            self._body_xyzw[:, block] = wxyz[:, bodies][..., [1, 2, 3, 0]].swapaxes(0, 1)
            self._capsule_m[block] = geom_m[:, capsules]
            matrices = geom_xmat[:, capsules].reshape(-1, 9).astype(np.float32)
            self._capsule_xyzw[block] = _xyzw(matrices).reshape(len(some), len(capsules), 4)
            low = np.minimum(low, geom_m[:, corners].min(axis=(0, 1)))
            high = np.maximum(high, geom_m[:, corners].max(axis=(0, 1)))
        self.centre_m = (low + high) / 2
        self.extent_m = max(float((high - low).max()), 0.1)

    def body(self, body: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Positions (K, 3) and orientations (K, 4), last entry real, of a body that has geoms."""
        place = self._body_place[body]
        return self._body_m[place], self._body_xyzw[place]

    def capsules(self, geoms: list[int]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Positions (K, n, 3) and orientations (K, n, 4), last entry real, of watched geoms."""
        places = [self._capsule_place[geom] for geom in geoms]
        return self._capsule_m[:, places], self._capsule_xyzw[:, places]


def _is_watched(model: mujoco.MjModel, geom: int) -> bool:
    """Whether it is one of the round geoms that stand for a robot's links."""
    rounds = (int(mujoco.mjtGeom.mjGEOM_CAPSULE), int(mujoco.mjtGeom.mjGEOM_SPHERE))
    return model.geom_group[geom] == WATCHED_GROUP and model.geom_type[geom] in rounds


def _load_scene(trace: Trace, scene_xml: Path | str) -> mujoco.MjModel:
    if not len(trace):
        raise TraceError(f"{trace.source}: has no rows to show")
    model = mujoco.MjModel.from_xml_path(str(scene_xml))
    if model.nq != trace.layout.nq:
        raise TraceError(
            f"{trace.source}: has {trace.layout.nq} coordinates, {scene_xml} has {model.nq}"
        )
    return model


def _origin(trace: Trace) -> dict[str, str]:
    """What a recording depends on."""
    return {
        "rerun": version("rerun-sdk"),
        "view": str(VIEW_VERSION),
        "trace_sha256": trace.digest(),
        "scenario": str(trace.metadata.get("scenario", "")),
    }


def _title(trace: Trace, out_rrd: Path) -> str:
    return str(trace.metadata.get("settings", {}).get("name", out_rrd.parent.name))


def _layout(trace: Trace, frames: _Frames) -> rrb.Blueprint:
    t_min_s = control_setting(trace, "t_min_s") or _FALLBACK_T_MIN_S

    def plot(origin: str, name: str, top: float | None = None) -> rrb.TimeSeriesView:
        return rrb.TimeSeriesView(
            origin=origin,
            name=name,
            axis_x=rrb.TimeAxis(link="LinkToGlobal"),
            axis_y=None if top is None else rrb.ScalarAxis(range=(0.0, top)),
            plot_legend=rrb.PlotLegend(corner="RightTop"),
        )

    eye = frames.centre_m + frames.extent_m * np.array([0.35, -1.35, 0.75])
    cell = rrb.Spatial3DView(
        origin="/world",
        name="Cell",
        background=[28, 28, 34],
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=rrb.EyeControls3D(
            position=tuple(eye), look_target=tuple(frames.centre_m), eye_up=(0, 0, 1)
        ),
    )
    events = rrb.TextLogView(
        origin="/events",
        name="Events",
        columns=rrb.TextLogColumns(
            timeline_columns=["sim_time"], text_log_columns=["loglevel", "body"]
        ),
    )
    curves = rrb.Vertical(
        plot("/ttc", "Time to collision [s]", TTC_CAP_IN_T_MIN * t_min_s),
        plot("/distance", "Smallest distance [m]"),
        plot("/artc", "ARTC [1/s]"),
        plot("/tool_speed", "Tool speed [m/s]"),
        plot("/scale", "Scale", 1.05),
        rrb.StateTimelineView(origin="/mode", name="Mode"),
        row_shares=[3, 2, 2, 2, 1.5, 2.2],
    )
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(cell, events, row_shares=[4, 1]), curves, column_shares=[1.1, 1]
        ),
        rrb.TimePanel(state="collapsed", timeline="sim_time", play_state="paused"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )


def _times(trace: Trace, rows: NDArray[np.int64]) -> list[rr.TimeColumn]:
    # Float seconds would be cut, not rounded, to nanoseconds.
    nanoseconds = np.round(trace["time_s"][rows] * 1e9).astype("timedelta64[ns]")
    return [
        rr.TimeColumn("sim_time", duration=nanoseconds),
        rr.TimeColumn("tick", sequence=trace["tick"][rows]),
    ]


def _send(
    recording: rr.RecordingStream,
    trace: Trace,
    entity: str,
    rows: NDArray[np.int64],
    part: Callable[[slice], Iterable[rr.ComponentColumn]],
) -> None:
    """Sends an entity's columns; `part` makes those of a slice of the rows."""
    for start in range(0, len(rows), _CHUNK_ROWS):
        piece = slice(start, start + _CHUNK_ROWS)
        recording.send_columns(entity, _times(trace, rows[piece]), part(piece))


def body_surfaces(
    model: mujoco.MjModel, arms: Sequence[str]
) -> Iterator[tuple[int, str, rr.Mesh3D]]:
    """What is drawn of every body that has anything to draw: its index, its entity, its surface in its own frame."""
    for body in range(model.nbody):
        drawn = [
            geom
            for geom in range(model.ngeom)
            if model.geom_bodyid[geom] == body and _is_drawn(model, geom)
        ]
        if not drawn:
            continue
        name = model.body(body).name or f"body_{body}"
        owner, slash, part = name.partition("/")
        if slash and owner in arms:
            entity = f"world/{owner}/housing/{part or 'base'}"
        else:
            entity = f"world/surroundings/{name.replace('/', '_')}"
        parts = [geom_triangles(model, geom) for geom in drawn]
        surface = joined(parts)
        colours = [
            np.tile(_geom_rgba(model, geom), (len(piece.vertices), 1))
            for geom, piece in zip(drawn, parts, strict=True)
        ]
        yield (
            body,
            entity,
            rr.Mesh3D(
                vertex_positions=surface.vertices.astype(np.float32),
                vertex_normals=surface.normals.astype(np.float32),
                vertex_colors=np.concatenate(colours),
                triangle_indices=surface.faces.astype(np.uint32),
            ),
        )


def _log_geometry(
    recording: rr.RecordingStream, trace: Trace, model: mujoco.MjModel, frames: _Frames
) -> None:
    recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    arms = trace.layout.arms
    for body, entity, surface in body_surfaces(model, arms):
        recording.log(entity, surface, static=True)
        position, xyzw = frames.body(body)
        if model.body_weldid[body] == 0:
            pose = rr.Transform3D(translation=position[0], quaternion=rr.Quaternion(xyzw=xyzw[0]))
            recording.log(entity, pose, static=True)
        else:
            _send(
                recording, trace, entity, frames.rows,
                lambda s, p=position, q=xyzw: rr.Transform3D.columns(
                    translation=p[s], quaternion=q[s]
                ),
            )  # fmt: skip
    for index, arm in enumerate(arms):
        _log_capsules(recording, trace, model, frames, arm, arm_colour(index))
    if trace.layout.pairs:
        _log_witness(recording, trace, frames.rows)


def _is_drawn(model: mujoco.MjModel, geom: int) -> bool:
    """Planes have no end and are left to the viewer's grid."""
    plane = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE
    return model.geom_group[geom] in DRAWN_GROUPS and not plane


def _geom_rgba(model: mujoco.MjModel, geom: int) -> NDArray[np.uint8]:
    """Colour of a geom; a pattern becomes its mean, for meshes here carry no texture."""
    material = int(model.geom_matid[geom])
    if material < 0:
        return np.round(255 * model.geom_rgba[geom]).astype(np.uint8)
    rgba = model.mat_rgba[material].astype(float)
    texture = int(model.mat_texid[material, mujoco.mjtTextureRole.mjTEXROLE_RGB])
    if texture >= 0:
        channels = int(model.tex_nchannel[texture])
        size = int(model.tex_height[texture] * model.tex_width[texture]) * channels
        first = int(model.tex_adr[texture])
        pixels = model.tex_data[first : first + size].reshape(-1, channels)
        rgba[:3] *= pixels[:, :3].mean(axis=0) / 255
    return np.round(255 * rgba).astype(np.uint8)


def _log_capsules(
    recording: rr.RecordingStream,
    trace: Trace,
    model: mujoco.MjModel,
    frames: _Frames,
    arm: str,
    colour: Rgb,
) -> None:
    """The watched capsules and spheres of an arm: shapes once, their poses as columns."""
    geoms = [
        geom
        for geom in range(model.ngeom)
        if _is_watched(model, geom) and model.geom(geom).name.startswith(f"{arm}/")
    ]
    if not geoms:
        return
    is_capsule = model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_CAPSULE
    length = np.where(is_capsule, 2 * model.geom_size[geoms, 1], 0.0)
    entity = f"world/{arm}/capsules"
    recording.log(
        entity,
        rr.Capsules3D(
            lengths=length,
            radii=model.geom_size[geoms, 0],
            # The viewer's capsule stands on its origin, MuJoCo's is centred on it.
            translations=np.column_stack([np.zeros((len(geoms), 2)), -length / 2]),
            colors=[[*colour, _CAPSULE_ALPHA]] * len(geoms),
            fill_mode="Solid",
        ),
        static=True,
    )
    position, xyzw = frames.capsules(geoms)
    _send(
        recording, trace, entity, frames.rows,
        lambda s: rr.InstancePoses3D.columns(
            translations=position[s].reshape(-1, 3),
            quaternions=xyzw[s].reshape(-1, 4),
        ).partition([len(geoms)] * len(position[s])),
    )  # fmt: skip


def _xyzw(matrices: NDArray[np.float32]) -> NDArray[np.float32]:
    """Rotation matrices (K, 9) as quaternions (K, 4), last entry real."""
    wxyz = np.empty((len(matrices), 4))
    for k, matrix in enumerate(matrices.astype(float)):
        mujoco.mju_mat2Quat(wxyz[k], matrix)
    return wxyz[:, [1, 2, 3, 0]].astype(np.float32)


def _log_witness(recording: rr.RecordingStream, trace: Trace, rows: NDArray[np.int64]) -> None:
    """A line between the witness points that matter now, red when time runs out."""
    strips = np.stack([trace["witness_i_m"][rows], trace["witness_j_m"][rows]], axis=1)
    known = np.isfinite(strips).all(axis=(1, 2))
    rows, strips = rows[known], strips[known].astype(np.float32)
    t_min_s = control_setting(trace, "t_min_s") or _FALLBACK_T_MIN_S
    danger = trace["ttc_s"][rows] < DANGER_MARGIN * t_min_s
    colours = np.where(danger[:, None], [DANGER], [CLOSEST]).astype(np.uint8)
    _send(
        recording, trace, "world/witness", rows,
        lambda s: rr.LineStrips3D.columns(
            strips=strips[s], colors=colours[s], radii=np.full(len(strips[s]), 0.005, np.float32)
        ),
    )  # fmt: skip


def _log_curves(recording: rr.RecordingStream, trace: Trace) -> None:
    every = np.arange(len(trace))
    arms = trace.layout.arms
    colours = [arm_colour(k) for k in range(len(arms))]

    def curves(
        entity: str,
        series: dict[str, NDArray[np.float64]],
        colours: list[Rgb],
        aggregation: Literal["Min", "Max"],
    ) -> None:
        if not series:
            return
        values = np.column_stack(list(series.values()))
        # When a pixel covers several ticks it must show the extreme that matters, not a mean.
        style = rr.SeriesLines(
            names=list(series), colors=[list(c) for c in colours], aggregation_policy=aggregation
        )
        recording.log(entity, style, static=True)
        _send(recording, trace, entity, every, lambda s: rr.Scalars.columns(scalars=values[s]))

    def level(value: float) -> NDArray[np.float64]:
        return np.full(len(trace), value)

    t_min_s = control_setting(trace, "t_min_s")
    cap_s = TTC_CAP_IN_T_MIN * (t_min_s or _FALLBACK_T_MIN_S)
    ttc, ttc_colours = {}, []
    # Later series are drawn over earlier ones, and scaling lays the curves onto the limit.
    if t_min_s is not None:
        ttc["t_min"] = level(t_min_s)
        ttc_colours.append(LIMIT)
    ttc["commanded"] = _capped(trace["ttc_command_s"], cap_s)
    ttc["measured"] = _capped(trace["ttc_s"], cap_s)
    ttc_colours += [COMMANDED, MEASURED]
    curves("ttc", ttc, [_on_dark(c) for c in ttc_colours], "Min")
    distance, distance_colours = {}, []
    if trace.layout.pairs:
        distance["capsules"] = smallest_distance_m(trace)
        distance_colours.append(MEASURED)
    if np.isfinite(trace["check_distance_m"]).any():
        distance["final check"] = _gap(trace["check_distance_m"])
        distance_colours.append(COMMANDED)
    d_min_m = control_setting(trace, "d_min_m")
    if d_min_m is not None:
        distance["d_min"] = level(d_min_m)
        distance_colours.append(LIMIT)
    curves("distance", distance, [_on_dark(c) for c in distance_colours], "Min")

    def per_arm(column: str) -> dict[str, NDArray[np.float64]]:
        return {arm: trace[f"{arm}.{column}"] for arm in arms}

    curves("artc", per_arm("artc_per_s"), colours, "Max")
    curves("tool_speed", per_arm("tool_speed_m_s"), colours, "Max")
    curves("scale", per_arm("scale"), colours, "Min")


def _capped(ttc_s: NDArray[np.float64], cap_s: float) -> NDArray[np.float64]:
    """Infinite where nothing closes, which is drawn as a gap, and at most the cap elsewhere."""
    return np.where(np.isnan(ttc_s), np.inf, np.minimum(ttc_s, cap_s))


def _gap(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Infinity draws a gap as NaN does, and compares equal to itself."""
    return np.where(np.isnan(values), np.inf, values)


def _on_dark(colour: Rgb) -> Rgb:
    """Figures have white paper, the viewer a dark ground: the measured curve turns light."""
    return (225, 225, 230) if colour == MEASURED else colour


def _log_modes(recording: rr.RecordingStream, trace: Trace) -> None:
    """Lanes of modes, and one event for every change of a mode or a reason."""
    lanes = {"cell": trace["mode"]}
    lanes |= {arm: trace[f"{arm}.mode"] for arm in trace.layout.arms}
    events: list[tuple[int, str, str]] = []
    for lane, mode in lanes.items():
        rows = _changes(mode)
        names = sorted(set(mode))
        recording.log(
            f"mode/{lane}",
            rr.StateConfiguration(
                values=names,
                labels=names,
                colors=[list(MODE_COLOURS.get(name, OTHER_MODE)) for name in names],
            ),
            static=True,
        )
        _send(
            recording, trace, f"mode/{lane}", rows,
            lambda s, states=mode[rows]: rr.StateChange.columns(state=states[s]),
        )  # fmt: skip
        for row in rows.tolist():
            level = "WARN" if mode[row] in ("halt", "stop") else "INFO"
            events.append((row, f"{lane}: {mode[row]}", level))
    entry = trace["entry"]
    events += [
        (row, f"presentations are asked to come from: {entry[row]}", "INFO")
        for row in _changes(entry).tolist()
        if entry[row]
    ]
    for arm in trace.layout.arms:
        reason = trace[f"{arm}.reason"]
        limiting = trace[f"{arm}.limiting_pair"]
        for row in _changes(reason).tolist():
            if not reason[row]:
                continue
            pair = int(limiting[row])
            where = f" ({' and '.join(trace.layout.pairs[pair])})" if pair >= 0 else ""
            events.append((row, f"{arm}: held back by {reason[row]}{where}", "INFO"))
    events.sort(key=lambda event: event[0])
    rows = np.array([row for row, _, _ in events])
    _send(
        recording, trace, "events", rows,
        lambda s: rr.TextLog.columns(
            text=[text for _, text, _ in events[s]], level=[level for _, _, level in events[s]]
        ),
    )  # fmt: skip


def _changes(values: NDArray[np.object_]) -> NDArray[np.int64]:
    """Rows at which a column takes another value, the first included."""
    return np.flatnonzero(np.concatenate([[True], values[1:] != values[:-1]]))
