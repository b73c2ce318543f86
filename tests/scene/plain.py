"""The plain way to make a scene and to choose its pairs: nothing kept, nothing cut short."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
from dm_control import mjcf

from workcell import assets
from workcell.scenario import Scenario
from workcell.scene import arm_file
from workcell.scene.addresses import ArmAddresses
from workcell.scene.normal_form import normal_form


def scene_xml(scenario: Scenario, pairs: tuple[tuple[str, str], ...]) -> str:
    """scene.xml as dm_control composes and writes all of it."""
    root = mjcf.RootElement(model=scenario.name)
    root.compiler.angle = "radian"
    root.option.timestep = scenario.simulation.period_s
    root.option.integrator = "implicitfast"
    root.visual.headlight.ambient = [0.28] * 3
    root.visual.headlight.diffuse = [0.18] * 3
    root.visual.headlight.specular = [0.0] * 3
    root.visual.get_children("global").offwidth = 1600
    root.visual.get_children("global").offheight = 1200
    picture = {"width": 256, "height": 256}
    root.asset.add(
        "texture",
        name="sky",
        type="skybox",
        builtin="gradient",
        rgb1=[0.93, 0.95, 0.97],
        rgb2=[0.62, 0.68, 0.74],
        **picture,
    )
    root.asset.add(
        "texture",
        name="tiles",
        type="2d",
        builtin="checker",
        rgb1=[0.62, 0.65, 0.68],
        rgb2=[0.56, 0.59, 0.62],
        **picture,
    )
    root.asset.add("material", name="tiles", texture="tiles", texrepeat=[6, 6], reflectance=0.05)
    world = root.worldbody
    lamp = {"directional": True, "diffuse": [0.5] * 3}
    world.add("light", name="lamp", pos=[0.5, -1.0, 3.0], dir=[-0.15, 0.3, -1.0], **lamp)
    lamp = {"directional": True, "diffuse": [0.15] * 3, "castshadow": False}
    world.add("light", name="fill", pos=[-1.0, 1.5, 2.5], dir=[0.4, -0.5, -1.0], **lamp)
    nothing = {"contype": 0, "conaffinity": 0}
    floor = {"type": "box", "size": [3, 3, 0.05], "pos": [0, 0, -0.05], "material": "tiles"}
    world.add("geom", name="floor", **floor, **nothing)
    for item in scenario.obstacle:
        world.add(
            "geom",
            name=item.name,
            type=item.shape,
            size=item.size_m,
            pos=item.position_m,
            quat=item.wxyz,
            rgba=item.rgba,
            **nothing,
        )
    for arm in scenario.arm:
        shipped = arm.model in assets.model_names()
        file = arm_file.read(assets.model_file(arm.model) if shipped else Path(arm.model))
        form = normal_form(file, np.array(arm.home_rad), range(len(file.joints)))
        model = mjcf.from_xml_string(form.xml, assets=form.assets)
        model.model = arm.name
        frame = root.attach(model)
        frame.pos, frame.quat = arm.base_position_m, arm.base_wxyz
    for item in scenario.instrument:
        body = world.add(
            "body", name=item.name, pos=item.position_m or [0, 0, 0], quat=item.wxyz, gravcomp=1
        )
        body.add("freejoint", name=f"{item.name}_free")
        radius, half, rgba = item.radius_m, item.half_length_m, item.rgba
        capsule = {"group": 4, "mass": item.mass_kg, "rgba": [*rgba[:3], 0.25]}
        rod = {"group": 2, "mass": 0, "rgba": rgba}
        for name, size, more in (
            ("capsule", [radius, half], capsule),
            ("rod", [0.9 * radius, half], rod),
        ):
            body.add(
                "geom", name=f"{item.name}_{name}", type="capsule", size=size, **nothing, **more
            )
    for k, (g, h) in enumerate(pairs):
        root.sensor.add("fromto", name=f"pair_{k}", geom1=g, geom2=h, cutoff=100)
    return root.to_xml_string(precision=17)


def extremes(
    model: mujoco.MjModel, arms: tuple[ArmAddresses, ...], g: int, h: int, poses: int
) -> tuple[float, float]:
    """Smallest and largest distance of two geoms over home and the first of the sampled poses."""
    data = mujoco.MjData(model)
    random = np.random.default_rng(0)
    distances = []
    for sample in range(poses):
        for arm in arms:
            low = np.where(np.isfinite(arm.lower_rad), arm.lower_rad, -np.pi)
            high = np.where(np.isfinite(arm.upper_rad), arm.upper_rad, np.pi)
            data.qpos[arm.qpos] = arm.home_rad if sample == 0 else random.uniform(low, high)
        mujoco.mj_kinematics(model, data)
        distances.append(mujoco.mj_geomDistance(model, data, g, h, 100.0, None))
    return min(distances), max(distances)
