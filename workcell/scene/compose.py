"""Scenario -> one MJCF scene.

Every arm's normal form is attached at its base pose under its own name (`surgeon/link3`), obstacles and the
floor become static geoms, and each watched pair gets a `fromto` sensor, so that MuJoCo itself
computes the witness points. What is simulated is what is written: the model is compiled from the
exported scene.xml.

dm_control takes a tenth of a second for an arm, and a study has the same arms in every run. So it
composes a skeleton, which is kept for further scenes of the same arms: the arms, what every scene
has, and a pattern each of an obstacle, an instrument and a sensor. What else a scenario says goes into
a copy of it: copies of the patterns, and numbers written as dm_control writes them.
"""

# pyright: reportOptionalMemberAccess=false
# The elements of an MJCF tree come into being at run time.

from __future__ import annotations

import copy
import hashlib
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import mujoco
from lxml import etree  # comes with dm_control, whose trees are made of it

from workcell.errors import InputError
from workcell.scenario import Instrument, Obstacle, Scenario
from workcell.scene.arm_file import KEPT
from workcell.scene.arm_part import ArmPart, arm_part
from workcell.scene.normal_form import NormalForm

with warnings.catch_warnings():
    # dm_control probes for a window system when imported; composing needs none.
    warnings.filterwarnings("ignore", module="glfw")
    from dm_control import mjcf

SCENE_FILE = "scene.xml"
FLOOR = "floor"
_FLOOR_HALF_EXTENTS_M = (3.0, 3.0, 0.05)
"""Chosen larger than any reach; a slab instead of a plane, which has no thickness to be seen from below."""
_SKY, _TILES = "sky", "tiles"
_OBSTACLE = Obstacle(name="obstacle", shape="sphere", size_m=(1.0,), position_m=(0.0, 0.0, 0.0))
_INSTRUMENT = Instrument(name="instrument", position_m=(0.0, 0.0, 0.0))


@dataclass(frozen=True)
class Scene:
    """A scene before it is compiled."""

    tree: etree._Element
    """Its MJCF tree."""
    assets: dict[str, bytes]
    """Content of the files it names, by name."""
    arms: tuple[ArmPart, ...]
    """Its arms, in the order of the scenario file."""
    arms_digest: str
    """SHA-256 of names and files of its arms: equal in all scenes of the same arms, wherever these stand."""


def compose(scenario: Scenario) -> Scene:
    """Build the scene without the sensors of its pairs.

    Raises:
        InputError: an arm file is missing, does not load, has no joints or no such tool site, or the
            home configuration has another number of joints.
    """
    parts: list[ArmPart] = []
    faults: list[str] = []
    for arm in scenario.arm:
        try:
            parts.append(arm_part(arm, scenario))
        except InputError as error:
            faults += error.faults
    if faults:
        raise InputError(faults, file=scenario.file)
    names = tuple(arm.name for arm in scenario.arm)
    skeleton = _skeleton(scenario.simulation.period_s, names, tuple(part.form for part in parts))
    tree = copy.deepcopy(skeleton.tree)
    tree.set("model", scenario.name)
    world = tree.find("worldbody")
    for arm in scenario.arm:
        _set(_child(world, "body", f"{arm.name}/"), pos=arm.base_position_m, quat=arm.base_wxyz)
    _replace(_child(world, "geom", _OBSTACLE.name), _obstacle, scenario.obstacle)
    _replace(_child(world, "body", _INSTRUMENT.name), _instrument, scenario.instrument)
    arms = "\n".join(f"{part.name} {part.digest}" for part in parts)
    return Scene(tree, skeleton.assets, tuple(parts), hashlib.sha256(arms.encode()).hexdigest())


@dataclass(frozen=True)
class _Skeleton:
    """What scenes of the same arms share."""

    tree: etree._Element
    assets: dict[str, bytes]


@lru_cache(maxsize=KEPT)
def _skeleton(period_s: float, names: tuple[str, ...], forms: tuple[NormalForm, ...]) -> _Skeleton:
    """The arms where nothing says otherwise, what every scene has, and the patterns; never to be changed."""
    root = mjcf.RootElement(model="skeleton")
    root.compiler.angle = "radian"
    root.option.timestep = period_s
    # implicitfast treats the servos' damping implicitly: stiff joint servos stay stable at the control period.
    root.option.integrator = "implicitfast"
    root.visual.headlight.ambient = [0.28, 0.28, 0.28]
    root.visual.headlight.diffuse = [0.18, 0.18, 0.18]
    root.visual.headlight.specular = [0.0, 0.0, 0.0]
    root.visual.get_children("global").offwidth = 1600
    root.visual.get_children("global").offheight = 1200
    root.asset.add(
        "texture",
        name=_SKY,
        type="skybox",
        builtin="gradient",
        rgb1=[0.93, 0.95, 0.97],
        rgb2=[0.62, 0.68, 0.74],
        width=256,
        height=256,
    )
    root.asset.add(
        "texture",
        name=_TILES,
        type="2d",
        builtin="checker",
        rgb1=[0.62, 0.65, 0.68],
        rgb2=[0.56, 0.59, 0.62],
        width=256,
        height=256,
    )
    root.asset.add("material", name=_TILES, texture=_TILES, texrepeat=[6, 6], reflectance=0.05)
    root.worldbody.add(
        "light",
        name="lamp",
        pos=[0.5, -1.0, 3.0],
        dir=[-0.15, 0.3, -1.0],
        directional=True,
        diffuse=[0.5, 0.5, 0.5],
    )
    root.worldbody.add(
        "light",
        name="fill",
        pos=[-1.0, 1.5, 2.5],
        dir=[0.4, -0.5, -1.0],
        directional=True,
        castshadow=False,
        diffuse=[0.15, 0.15, 0.15],
    )
    x, y, z = _FLOOR_HALF_EXTENTS_M
    root.worldbody.add(
        "geom",
        name=FLOOR,
        type="box",
        size=[x, y, z],
        pos=[0, 0, -z],
        material=_TILES,
        contype=0,
        conaffinity=0,
    )
    root.worldbody.add(
        "geom",
        name=_OBSTACLE.name,
        type=_OBSTACLE.shape,
        size=list(_OBSTACLE.size_m),
        pos=list(_OBSTACLE.position_m),
        quat=list(_OBSTACLE.wxyz),
        rgba=list(_OBSTACLE.rgba),
        contype=0,
        conaffinity=0,
    )
    for name, form in zip(names, forms, strict=True):
        model = _tree_of(form)
        model.model = name
        frame = root.attach(model)
        frame.pos, frame.quat = [0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]
    _add_instrument(root, _INSTRUMENT)
    # Makes a section of sensors, where dm_control wants it.
    root.sensor.add("fromto", name="pair", geom1=FLOOR, geom2=FLOOR)
    tree = root.to_xml(precision=17)
    sensors = tree.find("sensor")
    sensors.remove(_child(sensors, "fromto", "pair"))
    return _Skeleton(tree, root.get_assets())


def _add_instrument(root: mjcf.RootElement, instrument: Instrument) -> None:
    """A free rod: a watched capsule, and a housing of the same shape for the eye and the final check.

    It carries its own weight: what holds it, an arm's tool or the tray, is not modelled as contact.
    """
    position = [0.0, 0.0, 0.0] if instrument.position_m is None else list(instrument.position_m)
    body = root.worldbody.add(
        "body", name=instrument.name, pos=position, quat=list(instrument.wxyz), gravcomp=1.0
    )
    body.add("freejoint", name=f"{instrument.name}_free")
    size = [instrument.radius_m, instrument.half_length_m]
    shared = {"type": "capsule", "contype": 0, "conaffinity": 0}
    body.add(
        "geom",
        name=f"{instrument.name}_capsule",
        size=size,
        group=4,
        mass=instrument.mass_kg,
        rgba=[*instrument.rgba[:3], 0.25],
        **shared,
    )
    body.add(
        "geom",
        name=f"{instrument.name}_rod",
        size=[0.9 * size[0], size[1]],
        group=2,
        mass=0,
        rgba=list(instrument.rgba),
        **shared,
    )


def _obstacle(geom: etree._Element, obstacle: Obstacle) -> None:
    """Make a copy of the pattern into this obstacle."""
    geom.set("name", obstacle.name)
    geom.set("type", obstacle.shape)
    _set(
        geom, size=obstacle.size_m, pos=obstacle.position_m, quat=obstacle.wxyz, rgba=obstacle.rgba
    )


def _instrument(body: etree._Element, instrument: Instrument) -> None:
    """Make a copy of the pattern into this instrument."""
    for element in body.iter(etree.Element):
        element.set("name", element.get("name").replace(_INSTRUMENT.name, instrument.name))
    _set(body, pos=instrument.position_m or (0.0, 0.0, 0.0), quat=instrument.wxyz)
    radius, half_length, (*rgb, alpha) = (
        instrument.radius_m,
        instrument.half_length_m,
        instrument.rgba,
    )
    capsule, rod = body.iter("geom")
    _set(capsule, size=(radius, half_length), mass=(instrument.mass_kg,), rgba=(*rgb, 0.25))
    _set(rod, size=(0.9 * radius, half_length), rgba=(*rgb, alpha))


def add_sensors(scene: Scene, pairs: Sequence[tuple[str, str]], cutoff_m: float) -> None:
    """Give every watched pair its `fromto` sensor, named `pair_<index>`, before the arms' own sensors."""
    sensors = scene.tree.find("sensor")
    for index, (geom_i, geom_j) in enumerate(pairs):
        keys = {"name": f"pair_{index}", "cutoff": f"{cutoff_m:.17g}"}
        sensor = sensors.makeelement("fromto", keys | {"geom1": geom_i, "geom2": geom_j})
        sensors.insert(index, sensor)
    if not len(sensors):
        scene.tree.remove(sensors)


def export(scene: Scene, folder: Path) -> mujoco.MjModel:
    """Write scene.xml with its assets into `folder` and compile the model from what was written."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / SCENE_FILE).write_bytes(etree.tostring(scene.tree, pretty_print=True))
    for name, content in scene.assets.items():
        (folder / name).write_bytes(content)
    return mujoco.MjModel.from_xml_path(str(folder / SCENE_FILE))


def preview(scene: Scene) -> mujoco.MjModel:
    """Compile the scene as it is, without writing it and without sky and tiles, which take MuJoCo half of its time.

    Everything but textures, materials and sensors has the same number as in the model of the exported scene.
    """
    tree = copy.deepcopy(scene.tree)
    pictures = tree.find("asset")
    for tag, name in (("texture", _SKY), ("texture", _TILES), ("material", _TILES)):
        pictures.remove(_child(pictures, tag, name))
    del _child(tree.find("worldbody"), "geom", FLOOR).attrib["material"]
    return mujoco.MjModel.from_xml_string(etree.tostring(tree, encoding="unicode"), scene.assets)


def _child(parent: etree._Element, tag: str, name: str) -> etree._Element:
    """The one child of this tag and name."""
    (child,) = (child for child in parent.iterchildren(tag) if child.get("name") == name)
    return child


def _replace(
    pattern: etree._Element, fill: Callable[[etree._Element, Any], None], items: Iterable[Any]
) -> None:
    """Put a filled copy for every item where the pattern is."""
    for item in items:
        filled = copy.deepcopy(pattern)
        fill(filled, item)
        pattern.addprevious(filled)
    pattern.getparent().remove(pattern)


def _set(element: etree._Element, **numbers: Sequence[float]) -> None:
    """Set attributes with all digits, so that they are read back as they are."""
    for key, values in numbers.items():
        element.set(key, " ".join(f"{value:.17g}" for value in values))


def _tree_of(form: NormalForm) -> mjcf.RootElement:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", category=DeprecationWarning)
        return mjcf.from_xml_string(form.xml, assets=form.assets)
