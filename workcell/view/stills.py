"""Pictures of a scene, drawn by MuJoCo in a process of their own.

In come a scene and joint positions; out come pictures as arrays, one after the other. Which OpenGL
platform MuJoCo uses is settled when it is imported, and a platform that fails can take the process with
it, so each platform is tried in a fresh one. Run as a program, this file is that process.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from workcell.errors import InputError
from workcell.view.palette import arm_colour, unit_rgb

_PLATFORMS = ("egl", "osmesa") if sys.platform.startswith("linux") else ("",)
"""Those that need no screen, the faster first; elsewhere MuJoCo's own choice."""
_TINT = 0.55
"""Part of an arm's colour in its housing: arms are told apart and their shapes are still seen."""
_LINE_RADIUS_M = 0.006


class NoPictures(InputError):
    """No OpenGL platform of this machine can draw; says what each of them answered."""


@dataclass(frozen=True)
class Lines:
    """One line a picture, as between the nearest points of two bodies."""

    ends_m: NDArray[np.float64]
    """(K, 2, 3) in the world; NaN where a picture has none."""
    rgb: NDArray[np.float64]
    """(K, 3) colours from 0 to 1."""


def render(
    scene_xml: Path | str,
    qpos: NDArray[np.float64],
    *,
    width: int,
    height: int,
    arms: Sequence[str] = (),
) -> NDArray[np.uint8]:
    """Draws the scene at each position, all from one side that shows whatever moves.

    Args:
        scene_xml: The scene.
        qpos: Joint positions, (K, nq).
        width: Pixels.
        height: Pixels.
        arms: Names of arms, which are tinted in the colours that they have in all figures.

    Returns:
        Pictures, (K, height, width, 3).

    Raises:
        NoPictures: Nothing here can draw.
    """
    return np.array(list(frames(scene_xml, qpos, width=width, height=height, arms=arms)))


def frames(
    scene_xml: Path | str,
    qpos: NDArray[np.float64],
    *,
    width: int,
    height: int,
    arms: Sequence[str] = (),
    lines: Lines | None = None,
    seen_qpos: NDArray[np.float64] | None = None,
    draft: bool = False,
) -> Iterator[NDArray[np.uint8]]:
    """The same pictures one by one, as they are drawn, each (height, width, 3).

    Args:
        lines: A line to draw in each of them.
        seen_qpos: (N, nq) positions that the camera must show; None: those that are drawn.
        draft: Without shadows and smooth edges, which in software take four fifths of the time.
    """
    chosen = os.environ.get("MUJOCO_GL")
    answers = []
    with tempfile.TemporaryDirectory() as folder:
        job = Path(folder) / "job.npz"
        colours = [unit_rgb(arm_colour(k)) for k in range(len(arms))]
        none = Lines(np.full((len(qpos), 2, 3), np.nan), np.zeros((len(qpos), 3)))
        drawn = none if lines is None else lines
        np.savez(
            job, scene=str(Path(scene_xml).resolve()), qpos=qpos, size=[height, width],
            arms=np.array(list(arms), dtype=str), colours=np.array(colours).reshape(-1, 3),
            ends=drawn.ends_m, rgb=drawn.rgb, draft=draft,
            seen=qpos if seen_qpos is None else seen_qpos,
        )  # fmt: skip
        for platform in (chosen,) if chosen else _PLATFORMS:
            said = (Path(folder) / "said").open("w+")
            process = subprocess.Popen(
                [sys.executable, "-m", __spec__.name, str(job)],
                env={**os.environ, **({"MUJOCO_GL": platform} if platform else {})},
                stdout=subprocess.PIPE,
                stderr=said,
            )
            count = 0
            try:
                for picture in _read(process, height, width):
                    count += 1
                    yield picture
            finally:
                process.kill()
                process.wait()
            if count == len(qpos):
                return
            said.seek(0)
            last = (said.read().strip().splitlines() or ["no message"])[-1]
            answers.append(f"{platform or 'default'}: {last}")
            if count:
                break
    raise NoPictures(f"MuJoCo cannot draw here ({'; '.join(answers)})")


def _read(process: subprocess.Popen[bytes], height: int, width: int) -> Iterator[NDArray[np.uint8]]:
    """Pictures from a process until it ends; an unfinished one is dropped."""
    size = height * width * 3
    stream = process.stdout
    while stream is not None:
        content = stream.read(size)
        if len(content) < size:
            return
        yield np.frombuffer(content, np.uint8).reshape(height, width, 3)


def _main(job: str, out: IO[bytes]) -> None:
    import mujoco

    task = np.load(job)
    model = mujoco.MjModel.from_xml_path(str(task["scene"]))
    data = mujoco.MjData(model)
    height, width = (int(n) for n in task["size"])
    model.vis.global_.offheight = max(model.vis.global_.offheight, height)
    model.vis.global_.offwidth = max(model.vis.global_.offwidth, width)
    for arm, colour in zip(task["arms"], task["colours"], strict=True):
        _tint(model, str(arm), colour)
    draft = bool(task["draft"])
    if draft:
        model.vis.quality.offsamples = 0
    camera = _camera(model, data, task["seen"])
    option = mujoco.MjvOption()
    # The sensors that measure the watched pairs would be drawn as a web of rays.
    option.flags[mujoco.mjtVisFlag.mjVIS_RANGEFINDER] = False
    with mujoco.Renderer(model, height, width) as renderer:
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            renderer.scene.flags[flag] = not draft
        for q, ends, rgb in zip(task["qpos"], task["ends"], task["rgb"], strict=True):
            data.qpos[:] = q
            mujoco.mj_kinematics(model, data)
            mujoco.mj_camlight(model, data)
            renderer.update_scene(data, camera, option)
            if np.isfinite(ends).all():
                _line(renderer.scene, ends, rgb)
            out.write(renderer.render().tobytes())


def _tint(model, arm: str, colour: NDArray[np.float64]) -> None:
    """Give an arm's geoms some of its colour."""
    for geom in range(model.ngeom):
        if not model.body(model.geom_bodyid[geom]).name.startswith(f"{arm}/"):
            continue
        material = model.geom_matid[geom]
        own = model.geom_rgba[geom] if material < 0 else model.mat_rgba[material]
        model.geom_rgba[geom, :3] = (1 - _TINT) * own[:3] + _TINT * colour
        model.geom_rgba[geom, 3] = own[3]
        model.geom_matid[geom] = -1


def _camera(model, data, poses: NDArray[np.float64]):
    """One that frames everything that moves, over all pictures alike."""
    import mujoco

    moving = [g for g in range(model.ngeom) if model.body_weldid[model.geom_bodyid[g]] != 0]
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for q in poses:
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        seen = data.geom_xpos[moving or slice(None)]
        low, high = np.minimum(low, seen.min(axis=0)), np.maximum(high, seen.max(axis=0))
    camera = mujoco.MjvCamera()
    camera.lookat = (low + high) / 2
    camera.distance = 1.45 * max(float((high - low).max()), 0.3)
    camera.azimuth, camera.elevation = 105.0, -28.0
    return camera


def _line(scene, ends: NDArray[np.float64], rgb: NDArray[np.float64]) -> None:
    """Add a thick line to a scene that is about to be drawn."""
    import mujoco

    if scene.ngeom >= scene.maxgeom:
        return
    geom = scene.geoms[scene.ngeom]
    mujoco.mjv_initGeom(
        geom, mujoco.mjtGeom.mjGEOM_CAPSULE, np.zeros(3), np.zeros(3), np.eye(3).ravel(),
        np.array([*rgb, 1.0], dtype=np.float32),
    )  # fmt: skip
    mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_CAPSULE, _LINE_RADIUS_M, ends[0], ends[1])
    scene.ngeom += 1


if __name__ == "__main__":
    _main(sys.argv[1], sys.stdout.buffer)
