"""Still pictures of a scene, drawn by MuJoCo in a process of their own.

In come a scene and joint positions; out come pictures as arrays. Which OpenGL platform MuJoCo uses
is settled when it is imported, and a platform that fails can take the process with it, so each
platform is tried in a fresh one. Run as a program, this file is that process.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workcell.errors import WorkcellError

_PLATFORMS = ("egl", "osmesa") if sys.platform.startswith("linux") else ("",)
"""Those that need no screen, the faster first; elsewhere MuJoCo's own choice."""
_TIMEOUT_S = 120.0
"""Four pictures take about a second in software; far beyond it something hangs."""


class NoPictures(WorkcellError):
    """No OpenGL platform of this machine can draw; says what each of them answered."""


def render(
    scene_xml: Path | str, qpos: NDArray[np.float64], *, width: int, height: int
) -> NDArray[np.uint8]:
    """Draws the scene at each position, all from one side that shows whatever moves.

    Args:
        scene_xml: The scene.
        qpos: Joint positions, (K, nq).
        width: Pixels.
        height: Pixels.

    Returns:
        Pictures, (K, height, width, 3).

    Raises:
        NoPictures: Nothing here can draw.
    """
    chosen = os.environ.get("MUJOCO_GL")
    answers = []
    with tempfile.TemporaryDirectory() as folder:
        job, result = Path(folder) / "job.npz", Path(folder) / "pictures.npy"
        np.savez(job, scene=str(Path(scene_xml).resolve()), qpos=qpos, size=[height, width])
        for platform in (chosen,) if chosen else _PLATFORMS:
            environment = {**os.environ, **({"MUJOCO_GL": platform} if platform else {})}
            try:
                done = subprocess.run(
                    [sys.executable, "-m", __spec__.name, str(job), str(result)],
                    env=environment,
                    capture_output=True,
                    text=True,
                    timeout=_TIMEOUT_S,
                )
            except subprocess.TimeoutExpired:
                answers.append(f"{platform or 'default'}: no answer in {_TIMEOUT_S:g} s")
                continue
            if done.returncode == 0:
                return np.load(result)
            last = (done.stderr.strip().splitlines() or ["no message"])[-1]
            answers.append(f"{platform or 'default'}: {last}")
    raise NoPictures(f"MuJoCo cannot draw here ({'; '.join(answers)})")


def _main(job: str, result: str) -> None:
    import mujoco

    task = np.load(job)
    model = mujoco.MjModel.from_xml_path(str(task["scene"]))
    data = mujoco.MjData(model)
    height, width = (int(n) for n in task["size"])
    model.vis.global_.offheight = max(model.vis.global_.offheight, height)
    model.vis.global_.offwidth = max(model.vis.global_.offwidth, width)
    poses = task["qpos"]

    # The camera frames everything that moves, over all pictures alike.
    moving = [g for g in range(model.ngeom) if model.body_weldid[model.geom_bodyid[g]] != 0]
    seen = []
    for q in poses:
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        seen.append(data.geom_xpos[moving or slice(None)])
    corners = np.concatenate(seen)
    camera = mujoco.MjvCamera()
    camera.lookat = (corners.min(axis=0) + corners.max(axis=0)) / 2
    camera.distance = 1.45 * max(float(np.ptp(corners, axis=0).max()), 0.3)
    camera.azimuth, camera.elevation = 105.0, -28.0

    option = mujoco.MjvOption()
    # The sensors that measure the watched pairs would be drawn as a web of rays.
    option.flags[mujoco.mjtVisFlag.mjVIS_RANGEFINDER] = False

    pictures = []
    with mujoco.Renderer(model, height, width) as renderer:
        for q in poses:
            data.qpos[:] = q
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, camera, option)
            pictures.append(renderer.render().copy())
    np.save(result, np.array(pictures))


if __name__ == "__main__":
    _main(*sys.argv[1:])
