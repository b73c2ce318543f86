"""Models for the parts' tests: a slide before a wall, and two shipped arms in one scene."""

from __future__ import annotations

import mujoco

from workcell.assets import model_file


def slide(tail: str = "") -> mujoco.MjSpec:
    """A ball of 5 cm on a slide along x, a wall's face at x = 1, a second ball on a slide from the other side."""
    return mujoco.MjSpec.from_string(
        f"""<mujoco><worldbody>
          <body name="cart"><joint name="x" type="slide" axis="1 0 0" range="-2 2"/>
            <geom name="ball" size="0.05" mass="1"/></body>
          <body name="other" pos="0.6 0.5 0"><joint name="y" type="slide" axis="-1 0 0"/>
            <geom name="second" size="0.05" mass="1" contype="0" conaffinity="0"/></body>
          <geom name="wall" type="box" size="0.1 1 1" pos="1.1 0 0" contype="0" conaffinity="0"/>
          {tail}
        </worldbody></mujoco>"""
    )


def two_arms() -> mujoco.MjSpec:
    """Two planar arms a metre apart, `left/...` and `right/...`."""
    spec = mujoco.MjSpec()
    for name, x_m in (("left", -0.5), ("right", 0.5)):
        arm = mujoco.MjSpec.from_file(str(model_file("planar3")))
        spec.attach(arm, prefix=f"{name}/", frame=spec.worldbody.add_frame(pos=[x_m, 0, 0]))
    return spec
