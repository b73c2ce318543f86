"""Which actuator moves a joint, and how it takes a velocity command."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco


@dataclass(frozen=True)
class Servo:
    """How one joint's actuator takes a velocity command."""

    actuator: int
    kind: str
    """'position': force = kp (ctrl - q) - kv q̇.  'velocity': force = kv (ctrl - q̇)."""
    lead_s: float
    """kv / kp of a position servo: ctrl = q_ref + lead q̇_ref cancels its velocity lag; 0 otherwise."""


def acting_on(model: mujoco.MjModel, joint: int) -> list[int]:
    """Actuators of one joint."""
    return [
        a
        for a in range(model.nactuator)
        if model.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_JOINT
        and model.actuator_trnid[a, 0] == joint
    ]


def servo_of(model: mujoco.MjModel, joint: int) -> Servo | str:
    """The joint's one position or velocity servo, or what is wrong."""
    acting = acting_on(model, joint)
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
