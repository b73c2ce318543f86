"""Names -> ids, once.

Everything the control loop needs to address an arm in the compiled scene is resolved here, at
construction, and fails here.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.errors import InputError
from workcell.scenario import Arm, Scenario
from workcell.scene.arm_file import ACCELERATION_LIMIT_NUMERIC, VELOCITY_LIMIT_NUMERIC, plain
from workcell.scene.arm_part import ArmPart
from workcell.scene.servos import Servo, acting_on, servo_of

DEFAULT_VELOCITY_LIMIT_RAD_S = 1.0
"""For arm files that name no limit: chosen slow, as the PA10's slowest joints."""
DEFAULT_ACCELERATION_LIMIT_RAD_S2 = 2.0
"""For arm files that name no limit: half a second to full default speed, chosen gentle."""


@dataclass(frozen=True)
class ArmAddresses:
    """Addresses and limits of one arm in the compiled scene; n is its number of joints."""

    name: str
    support: bool
    """Its role, decided here: jobs drive a support arm, which is slowed down and gives way; an operator drives a priority arm."""
    priority: int
    joints: tuple[str, ...]
    dofs: NDArray[np.intp]
    """(n,) indices into qvel."""
    qpos: NDArray[np.intp]
    """(n,) indices into qpos."""
    home_rad: NDArray[np.float64]
    lower_rad: NDArray[np.float64]
    """(n,) joint range, -inf where unlimited."""
    upper_rad: NDArray[np.float64]
    velocity_limit_rad_s: NDArray[np.float64]
    acceleration_limit_rad_s2: NDArray[np.float64]
    tool_site: int
    tool_site_name: str
    elbow_site: int | None
    geoms: tuple[int, ...]
    """Watched geoms of the arm."""
    servos: tuple[Servo, ...]
    """One a joint, in joint order; none for an arm that is only moved kinematically and has none."""
    assumed: tuple[str, ...] = ()
    """What neither scenario nor arm file states and is therefore assumed, a sentence each."""


@dataclass(frozen=True)
class InstrumentAddresses:
    """Addresses of one instrument in the compiled scene."""

    name: str
    body: int
    geom: int
    """Its watched capsule."""
    qpos: int
    """Where its free joint's position and quaternion start in qpos."""
    dof: int
    """Where its free joint's six velocities start in qvel."""
    radius_m: float
    half_length_m: float
    rests_on: tuple[str, ...]
    """Obstacles it lies on, which it is not watched against."""
    held_by: str | None
    """Arm that holds it at the start."""


def instrument_addresses(
    model: mujoco.MjModel, scenario: Scenario
) -> tuple[InstrumentAddresses, ...]:
    """Resolve all instruments, in the order of the scenario file."""
    return tuple(
        InstrumentAddresses(
            name=item.name,
            body=model.body(item.name).id,
            geom=model.geom(f"{item.name}_capsule").id,
            qpos=int(model.joint(f"{item.name}_free").qposadr[0]),
            dof=int(model.joint(f"{item.name}_free").dofadr[0]),
            radius_m=item.radius_m,
            half_length_m=item.half_length_m,
            rests_on=item.rests_on,
            held_by=item.held_by,
        )
        for item in scenario.instrument
    )


def arm_addresses(
    model: mujoco.MjModel, scenario: Scenario, parts: Sequence[ArmPart]
) -> tuple[ArmAddresses, ...]:
    """Resolve all arms of the scenario, in the order of the scenario file.

    Args:
        model: The composed scene.
        scenario: Whose arms.
        parts: What was attached for each of them.
    """
    faults: list[str] = []
    arms: list[ArmAddresses] = []
    for arm, part in zip(scenario.arm, parts, strict=True):
        try:
            arms.append(_resolve(model, arm, part, scenario.simulation.plant == "dynamic"))
        except InputError as error:
            faults += error.faults
    if faults:
        raise InputError(faults, file=scenario.file)
    return tuple(arms)


def arm_of_geom(model: mujoco.MjModel, geom: int, arms: tuple[str, ...]) -> str | None:
    """Name of the arm a geom belongs to, None for the static surroundings."""
    owner, slash, _ = model.geom(geom).name.partition("/")
    return owner if slash and owner in arms else None


def _resolve(model: mujoco.MjModel, arm: Arm, part: ArmPart, dynamic: bool) -> ArmAddresses:
    prefix = f"{arm.name}/"
    names = tuple(prefix + part.file.joints[joint] for joint in part.driven)
    joints = [model.joint(name).id for name in names]
    qpos = model.jnt_qposadr[joints].astype(np.intp)
    dofs = model.jnt_dofadr[joints].astype(np.intp)
    limited = model.jnt_limited[joints].astype(bool)
    lower = np.where(limited, model.jnt_range[joints, 0], -np.inf)
    upper = np.where(limited, model.jnt_range[joints, 1], np.inf)
    home = part.home_rad
    faults = [
        f"arm.{arm.name}.home_rad.{k} = {home[k]:g}: joint {names[k]} allows {lower[k]:.4g} to {upper[k]:.4g} rad"
        for k in np.flatnonzero((home < lower) | (home > upper))
    ]
    if not part.watched:
        faults.append(
            f"arm.{arm.name}.model: has no geoms to watch; give its links capsules of group 4"
        )
    servos = [servo_of(model, joint) for joint in joints]
    # A kinematic arm needs no actuators; what it has must be what the controller can command.
    if dynamic or any(acting_on(model, joint) for joint in joints):
        faults += _servo_faults(arm, names, servos)
    limits, assumed = [], []
    for quantity, numeric, override, default in (
        (
            "velocity_limit_rad_s",
            VELOCITY_LIMIT_NUMERIC,
            arm.velocity_limit_rad_s,
            DEFAULT_VELOCITY_LIMIT_RAD_S,
        ),
        (
            "acceleration_limit_rad_s2",
            ACCELERATION_LIMIT_NUMERIC,
            arm.acceleration_limit_rad_s2,
            DEFAULT_ACCELERATION_LIMIT_RAD_S2,
        ),
    ):
        try:
            found = _limit(model, arm, part, quantity, numeric, override)
        except InputError as error:
            faults += error.faults
            continue
        if found is None:
            found = np.full(len(names), default)
            assumed.append(
                f"arm.{arm.name}: neither {quantity} of the scenario nor {numeric} of the arm file is stated: {default:g} for every joint is assumed"
            )
        limits.append(found)
    if faults:
        raise InputError(faults)
    velocity, acceleration = limits
    elbow = None if arm.elbow_site is None else model.site(prefix + plain(arm.elbow_site)).id
    return ArmAddresses(
        name=arm.name,
        support=bool(arm.job),
        priority=arm.priority,
        joints=names,
        dofs=dofs,
        qpos=qpos,
        home_rad=home,
        lower_rad=lower,
        upper_rad=upper,
        velocity_limit_rad_s=velocity,
        acceleration_limit_rad_s2=acceleration,
        tool_site=model.site(prefix + plain(arm.tool_site)).id,
        tool_site_name=prefix + plain(arm.tool_site),
        elbow_site=elbow,
        geoms=tuple(model.geom(prefix + name).id for name in part.watched),
        servos=tuple(servo for servo in servos if not isinstance(servo, str)),
        assumed=tuple(assumed),
    )


def _servo_faults(arm: Arm, names: Sequence[str], servos: Sequence[Servo | str]) -> Iterator[str]:
    """What the dynamic plant lacks, joints of one fault in one line."""
    reasons: dict[str, list[str]] = {}
    for name, servo in zip(names, servos, strict=True):
        if isinstance(servo, str):
            reasons.setdefault(servo, []).append(name)
    for reason, joints in reasons.items():
        yield (
            f"arm.{arm.name}.model: {', '.join(joints)}: {reason}. Give each one <position joint=... kp=... kv=.../>; "
            "an arm without any actuator can be run with simulation.plant = 'kinematic'"
        )


def _limit(
    model: mujoco.MjModel,
    arm: Arm,
    part: ArmPart,
    quantity: str,
    numeric: str,
    override: tuple[float, ...] | None,
) -> NDArray[np.float64] | None:
    """A per-joint limit: the scenario's, else the arm file's `<numeric>`, else None."""
    n = len(part.driven)
    if override is not None:
        found = part.of_driven(override)
        if len(found) != n:
            raise InputError(
                f"arm.{arm.name}.{quantity}: has {len(override)} entries; {n} are needed, one a driven joint"
            )
        return found
    identifier = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, f"{arm.name}/{numeric}")
    if identifier < 0:
        return None
    start, size = model.numeric_adr[identifier], model.numeric_size[identifier]
    values = np.array(model.numeric_data[start : start + size])
    if size != n or not (np.isfinite(values).all() and (values > 0).all()):
        raise InputError(
            f"arm.{arm.name}.model: numeric {numeric} = {values.tolist()}: {n} positive values are needed, one a joint"
        )
    return values
