"""A small cell for the tests of the final check: two arms with every kind of convex piece.

Each arm has five joints and eight pieces (boxes, cylinders, a convex mesh, a capsule), stands on
a table, and is named as the composer names an attached arm. Far-apart bodies can meet.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workcell.guard.settings import CheckSettings

ARMS = ("nurse", "surgeon")
PERIOD_S = 0.002

# A wedge: six corners, so that its hull is no box.
WEDGE = "-.03 -.03 0  .03 -.03 0  .03 .03 0  -.03 .03 0  0 -.02 .1  0 .02 .1"

ARM = """
<body name="{a}/base" pos="{x} 0 0.002">
  <geom name="{a}/base_plate" type="box" size=".08 .08 .01" pos="0 0 .01" class="housing"/>
  <body name="{a}/link1" pos="0 0 .02">
    <joint name="{a}/J1" axis="0 0 1"/>
    <geom name="{a}/link1_drum" type="cylinder" size=".06 .04" pos="0 0 .04" class="housing"/>
    <body name="{a}/link2" pos="0 0 .12">
      <joint name="{a}/J2" axis="0 1 0"/>
      <geom name="{a}/link2_hub" type="cylinder" size=".04 .05" euler="90 0 0" class="housing"/>
      <geom name="{a}/link2_bar" type="box" size=".03 .02 .08" pos="0 0 .12" class="housing"/>
      <geom name="{a}/link2_capsule" type="capsule" size=".06" fromto="0 0 0 0 0 .24" group="4"/>
      <body name="{a}/link3" pos="0 0 .26">
        <joint name="{a}/J3" axis="0 1 0"/>
        <geom name="{a}/link3_bar" type="cylinder" size=".025 .1" pos="0 0 .11" class="housing"/>
        <body name="{a}/link4" pos="0 0 .24">
          <joint name="{a}/J4" axis="1 0 0"/>
          <geom name="{a}/link4_wedge" type="mesh" mesh="wedge" class="housing"/>
          <body name="{a}/tool" pos="0 0 .11">
            <joint name="{a}/J5" axis="0 0 1"/>
            <geom name="{a}/tool_tip" type="capsule" size=".008 .03" pos=".01 0 .04"
                  class="housing"/>
          </body>
        </body>
      </body>
    </body>
  </body>
</body>
"""

SCENE = """
<mujoco>
  <compiler angle="degree"/>
  <asset><mesh name="wedge" vertex="{wedge}"/></asset>
  <default>
    <default class="housing"><geom group="2" contype="0" conaffinity="0"/></default>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="2 2 .1" pos="0 0 -.5"/>
    <geom name="table" type="box" size=".6 .4 .02" pos="0 0 -.02"/>
    <geom name="post" type="cylinder" size=".03 .3" pos="0 .3 .3"/>
    {bodies}
  </worldbody>
  {extra}
</mujoco>
"""


def scene_text(*, bodies: str | None = None, extra: str = "") -> str:
    """The scene as MJCF text; both arms unless other bodies are given."""
    if bodies is None:
        bodies = ARM.format(a="nurse", x=-0.3) + ARM.format(a="surgeon", x=0.3)
    return SCENE.format(wedge=WEDGE, bodies=bodies, extra=extra)


def write_scene(folder: Path, text: str | None = None) -> Path:
    """Writes the scene into a folder and returns its path."""
    path = folder / "scene.xml"
    path.write_text(text if text is not None else scene_text())
    return path


def settings(**changes: object) -> CheckSettings:
    """Settings for the cell; every test runs against its own every_ticks of 1."""
    chosen = {"arms": ARMS, "d_min_m": 0.005, "period_s": PERIOD_S, "every_ticks": 1} | changes
    return CheckSettings(**chosen)  # pyright: ignore[reportArgumentType]


def random_pose(rng: np.random.Generator) -> NDArray[np.float64]:
    """A configuration in which the arms lean towards each other, so that much is near."""
    qpos = rng.uniform(-1.0, 1.0, 10)
    qpos[[1, 2]] += 0.6
    qpos[[6, 7]] -= 0.6
    return qpos


# Upright arms: everything is far from everything.
CLEAR_POSE = np.zeros(10)
# Both arms lean onto the line between them until their forearms meet.
CRASH_POSE = np.array([0.0, 1.1, 0.3, 0.0, 0.0, 0.0, -1.1, -0.3, 0.0, 0.0])
