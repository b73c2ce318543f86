"""Scenario -> one MJCF scene.

Every arm file is attached at its base pose under its own name (`surgeon/link3`), obstacles and the
floor become static geoms, and each watched pair gets a `fromto` sensor, so that MuJoCo itself
computes the witness points. What is simulated is what is written: the model is compiled from the
exported scene.xml. The only file that knows dm_control.
"""

# pyright: reportOptionalMemberAccess=false
# The elements of an MJCF tree come into being at run time.

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import mujoco

from workcell import assets
from workcell.errors import InputError
from workcell.scenario import Arm, Instrument, Scenario

with warnings.catch_warnings():
    # dm_control probes for a window system when imported; composing needs none.
    warnings.filterwarnings("ignore", module="glfw")
    from dm_control import mjcf

SCENE_FILE = "scene.xml"
FLOOR = "floor"
_FLOOR_HALF_EXTENTS_M = (3.0, 3.0, 0.05)
"""Chosen larger than any reach; a slab instead of a plane, which has no thickness to be seen from below."""


def compose(scenario: Scenario) -> mjcf.RootElement:
    """Build the scene without its sensors.

    Raises:
        InputError: an arm file is missing, does not load, has no joints or no such tool site, or the
            home configuration has another number of joints.
    """
    root = mjcf.RootElement(model=scenario.name)
    root.compiler.angle = "radian"
    root.option.timestep = scenario.simulation.period_s
    # implicitfast treats the servos' damping implicitly: stiff joint servos stay stable at the control period.
    root.option.integrator = "implicitfast"
    root.visual.headlight.ambient = [0.28, 0.28, 0.28]
    root.visual.headlight.diffuse = [0.18, 0.18, 0.18]
    root.visual.headlight.specular = [0.0, 0.0, 0.0]
    root.visual.get_children("global").offwidth = 1600
    root.visual.get_children("global").offheight = 1200
    root.asset.add(
        "texture",
        name="sky",
        type="skybox",
        builtin="gradient",
        rgb1=[0.93, 0.95, 0.97],
        rgb2=[0.62, 0.68, 0.74],
        width=256,
        height=256,
    )
    root.asset.add(
        "texture",
        name="tiles",
        type="2d",
        builtin="checker",
        rgb1=[0.62, 0.65, 0.68],
        rgb2=[0.56, 0.59, 0.62],
        width=256,
        height=256,
    )
    root.asset.add("material", name="tiles", texture="tiles", texrepeat=[6, 6], reflectance=0.05)
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
        material="tiles",
        contype=0,
        conaffinity=0,
    )
    for obstacle in scenario.obstacle:
        root.worldbody.add(
            "geom",
            name=obstacle.name,
            type=obstacle.shape,
            size=list(obstacle.size_m),
            pos=list(obstacle.position_m),
            quat=list(obstacle.wxyz),
            rgba=list(obstacle.rgba),
            contype=0,
            conaffinity=0,
        )
    faults: list[str] = []
    for arm in scenario.arm:
        try:
            model = _arm_model(arm)
        except InputError as error:
            faults += error.faults
            continue
        frame = root.attach(model)
        frame.pos = list(arm.base_position_m)
        frame.quat = list(arm.base_wxyz)
    if faults:
        raise InputError(faults, file=scenario.file)
    for instrument in scenario.instrument:
        _add_instrument(root, instrument)
    return root


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


def add_sensors(root: mjcf.RootElement, pairs: Sequence[tuple[str, str]], cutoff_m: float) -> None:
    """Give every watched pair its `fromto` sensor, named `pair_<index>`."""
    for index, (geom_i, geom_j) in enumerate(pairs):
        root.sensor.add("fromto", name=f"pair_{index}", geom1=geom_i, geom2=geom_j, cutoff=cutoff_m)


def export(root: mjcf.RootElement, folder: Path) -> mujoco.MjModel:
    """Write scene.xml with its assets into `folder` and compile the model from what was written."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / SCENE_FILE).write_text(root.to_xml_string(precision=17), encoding="utf-8")
    for name, content in root.get_assets().items():
        (folder / name).write_bytes(content)
    return mujoco.MjModel.from_xml_path(str(folder / SCENE_FILE))


def _arm_model(arm: Arm) -> mjcf.RootElement:
    """Load one arm file and refuse what cannot be driven, all reasons at once."""
    path = assets.model_file(arm.model) if arm.model in assets.model_names() else Path(arm.model)
    key = f"arm.{arm.name}"
    if not path.is_file():
        raise InputError(
            f"{key}.model = {arm.model!r}: no such arm file; allowed: a path to an MJCF file, or one of {', '.join(assets.model_names())}"
        )
    try:
        with _quiet_parser():
            model = mjcf.from_path(str(path))
    except (
        Exception
    ) as error:  # whatever the XML parser, the schema or an include raises, the file is at fault
        raise InputError(
            f"{key}.model = {str(path)!r}: is not a readable MJCF file: {error}"
        ) from error
    model.model = arm.name
    joints = model.find_all("joint")
    faults = []
    if not joints:
        faults.append(
            f"{key}.model = {str(path)!r}: has no joints; an arm needs at least one hinge or slide joint"
        )
    for joint in joints:
        if joint.tag == "freejoint" or (joint.type or "hinge") not in ("hinge", "slide"):
            faults.append(
                f"{key}.model = {str(path)!r}: joint {joint.name!r} is of type {joint.tag if joint.tag == 'freejoint' else joint.type}; allowed are hinge and slide"
            )
    if joints and len(joints) != len(arm.home_rad):
        faults.append(
            f"{key}.home_rad: has {len(arm.home_rad)} entries, {path.name} has {len(joints)} joints ({', '.join(j.name or '?' for j in joints)})"
        )
    sites = [site.name for site in model.find_all("site")]
    for site_key, site in (("tool_site", arm.tool_site), ("elbow_site", arm.elbow_site)):
        if site is not None and site not in sites:
            faults.append(
                f"{key}.{site_key} = {site!r}: no such site in {path.name}; allowed: {', '.join(s for s in sites if s) or 'it has no sites'}"
            )
    if model.find_all("key"):
        faults.append(
            f"{key}.model = {str(path)!r}: has a keyframe, which cannot be attached beside other arms; remove it"
        )
    if faults:
        raise InputError(faults)
    for body in model.find_all("body"):
        for geom in body.find_all("geom", immediate_children_only=True):
            # A collision here is a verdict of the checks, not a bounce: contacts would only blur it.
            geom.contype, geom.conaffinity = 0, 0
    return model


@contextmanager
def _quiet_parser() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", category=DeprecationWarning)
        yield
