"""Names -> ids, once.

Everything the control loop needs to address an arm in the compiled scene is resolved here, at
construction, and fails here.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.errors import InputError
from workcell.scenario import Arm, Scenario

WATCHED_GROUP = 4
"""Geom group of the watched capsules."""
HOUSING_GROUP = 2
"""Geom group of the housings: what is drawn, and what the final check holds apart."""

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
    """One a joint, in joint order."""


@dataclass(frozen=True)
class Servo:
    """How one joint's actuator takes a velocity command."""

    actuator: int
    kind: str
    """'position': force = kp (ctrl - q) - kv q̇.  'velocity': force = kv (ctrl - q̇)."""
    lead_s: float
    """kv / kp of a position servo: ctrl = q_ref + lead q̇_ref cancels its velocity lag; 0 otherwise."""


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


def arm_addresses(model: mujoco.MjModel, scenario: Scenario) -> tuple[ArmAddresses, ...]:
    """Resolve all arms of the scenario, in the order of the scenario file."""
    faults: list[str] = []
    arms: list[ArmAddresses] = []
    for arm in scenario.arm:
        try:
            arms.append(_resolve(model, arm))
        except InputError as error:
            faults += error.faults
    if faults:
        raise InputError(faults, file=scenario.file)
    return tuple(arms)


def arm_of_geom(model: mujoco.MjModel, geom: int, arms: tuple[str, ...]) -> str | None:
    """Name of the arm a geom belongs to, None for the static surroundings."""
    owner, slash, _ = model.geom(geom).name.partition("/")
    return owner if slash and owner in arms else None


def watched_geoms(model: mujoco.MjModel, arm: str) -> list[int]:
    """The arm's capsules (group 4); for an arm file without any, all of its geoms."""
    own = [g for g in range(model.ngeom) if model.geom(g).name.startswith(f"{arm}/")]
    return [g for g in own if model.geom_group[g] == WATCHED_GROUP] or own


def _resolve(model: mujoco.MjModel, arm: Arm) -> ArmAddresses:
    prefix = f"{arm.name}/"
    joints = [j for j in range(model.njnt) if model.joint(j).name.startswith(prefix)]
    qpos = model.jnt_qposadr[joints].astype(np.intp)
    dofs = model.jnt_dofadr[joints].astype(np.intp)
    limited = model.jnt_limited[joints].astype(bool)
    lower = np.where(limited, model.jnt_range[joints, 0], -np.inf)
    upper = np.where(limited, model.jnt_range[joints, 1], np.inf)
    home = np.array(arm.home_rad)
    names = tuple(model.joint(j).name for j in joints)
    faults = [
        f"arm.{arm.name}.home_rad.{k} = {home[k]:g}: joint {names[k]} allows {lower[k]:.4g} to {upper[k]:.4g} rad"
        for k in np.flatnonzero((home < lower) | (home > upper))
    ]
    geoms = watched_geoms(model, arm.name)
    if not geoms:
        faults.append(f"arm.{arm.name}.model: has no named geoms to watch")
    servos = []
    for joint, name in zip(joints, names, strict=True):
        servo = _servo(model, joint)
        if isinstance(servo, str):
            faults.append(f"arm.{arm.name}.model: joint {name}: {servo}")
        else:
            servos.append(servo)
    if faults:
        raise InputError(faults)
    elbow = None if arm.elbow_site is None else model.site(prefix + arm.elbow_site).id
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
        velocity_limit_rad_s=_limit(
            model,
            arm,
            "joint_velocity_limit_rad_s",
            arm.velocity_limit_rad_s,
            DEFAULT_VELOCITY_LIMIT_RAD_S,
        ),
        acceleration_limit_rad_s2=_limit(
            model,
            arm,
            "joint_acceleration_limit_rad_s2",
            arm.acceleration_limit_rad_s2,
            DEFAULT_ACCELERATION_LIMIT_RAD_S2,
        ),
        tool_site=model.site(prefix + arm.tool_site).id,
        tool_site_name=prefix + arm.tool_site,
        elbow_site=elbow,
        geoms=tuple(geoms),
        servos=tuple(servos),
    )


def _limit(
    model: mujoco.MjModel,
    arm: Arm,
    numeric: str,
    override: tuple[float, ...] | None,
    default: float,
) -> NDArray[np.float64]:
    """A per-joint limit: the scenario's, else the arm file's `<numeric>`, else the default."""
    n = len(arm.home_rad)
    if override is not None:
        return np.array(override)
    identifier = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, f"{arm.name}/{numeric}")
    if identifier < 0:
        return np.full(n, default)
    start, size = model.numeric_adr[identifier], model.numeric_size[identifier]
    values = np.array(model.numeric_data[start : start + size])
    if size != n or not (np.isfinite(values).all() and (values > 0).all()):
        raise InputError(
            f"arm.{arm.name}.model: numeric {numeric} = {values.tolist()}: {n} positive values are needed, one a joint"
        )
    return values


def _servo(model: mujoco.MjModel, joint: int) -> Servo | str:
    """The joint's one position or velocity servo, or what is wrong."""
    acting = [
        a
        for a in range(model.nu)
        if model.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_JOINT
        and model.actuator_trnid[a, 0] == joint
    ]
    if len(acting) != 1:
        return (
            f"is moved by {len(acting)} actuators; exactly one position or velocity servo is needed"
        )
    (actuator,) = acting
    if model.actuator_dyntype[actuator] != mujoco.mjtDyn.mjDYN_NONE:
        return "its actuator has dynamics of its own (timeconst, an integrator); a plain position or velocity servo is needed"
    gain, bias = model.actuator_gainprm[actuator], model.actuator_biasprm[actuator]
    if (
        model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED
        and model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_AFFINE
        and model.actuator_gear[actuator, 0] == 1.0
    ):
        if gain[0] > 0 and bias[1] == -gain[0]:
            return Servo(actuator, "position", -bias[2] / gain[0])
        if gain[0] > 0 and bias[1] == 0 and bias[2] == -gain[0]:
            return Servo(actuator, "velocity", 0.0)
    return "its actuator is neither a position nor a velocity servo with gear 1"
