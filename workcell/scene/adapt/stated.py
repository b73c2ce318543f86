"""Limits of an arm: what its file states, else what its maker publishes, else something conservative; and which it was."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.scene.adapt.limits import published
from workcell.scene.addresses import (
    DEFAULT_ACCELERATION_LIMIT_RAD_S2,
    DEFAULT_VELOCITY_LIMIT_RAD_S,
)
from workcell.scene.arm_file import ACCELERATION_LIMIT_NUMERIC, VELOCITY_LIMIT_NUMERIC, ArmFile

SECONDS_TO_FULL_SPEED = 0.5
"""Where no acceleration limit is published: chosen gentle."""


@dataclass(frozen=True)
class Limits:
    """Of the driven joints, and what is said of them."""

    velocity: NDArray[np.float64]
    """(n,) rad/s or m/s."""
    acceleration: NDArray[np.float64]
    """(n,) rad/s² or m/s²."""
    guessed: list[str]
    unknown: list[str]


def limits(file: ArmFile, name: str, driven: tuple[int, ...]) -> Limits:
    """Speed and acceleration: the file's own, else published, else conservative; what it was is said."""
    known = published(f"{name} {file.path.parent.name} {file.path.stem}", len(driven))
    guessed, unknown, found = [], [], []
    table = {
        VELOCITY_LIMIT_NUMERIC: known.velocity_rad_s if known else None,
        ACCELERATION_LIMIT_NUMERIC: known.acceleration_rad_s2 if known else None,
    }
    for numeric, values in table.items():
        stated = _stated(file, numeric, driven)
        if isinstance(stated, str):
            unknown.append(stated)
            stated = None
        if stated is not None:
            found.append(stated)
        elif values is not None and known is not None:
            found.append(np.array(values))
            guessed.append(
                f"{numeric}: by its name this is an arm of which is published: {known.source}"
            )
        elif numeric == ACCELERATION_LIMIT_NUMERIC and known is not None:
            found.append(np.array(known.velocity_rad_s) / SECONDS_TO_FULL_SPEED)
            unknown.append(
                f"{numeric}: not published; {SECONDS_TO_FULL_SPEED:g} s to full speed assumed"
            )
        else:
            default = (
                DEFAULT_VELOCITY_LIMIT_RAD_S
                if numeric == VELOCITY_LIMIT_NUMERIC
                else DEFAULT_ACCELERATION_LIMIT_RAD_S2
            )
            found.append(np.full(len(driven), default))
            unknown.append(
                f"{numeric}: neither stated nor published; {default:g} for every joint assumed, on the slow side"
            )
    return Limits(found[0], found[1], guessed, unknown)


def torque(file: ArmFile, driven: tuple[int, ...]) -> dict[int, tuple[float, float]]:
    """Torque limits by joint, as far as the file has any: of the joint, else of its actuator."""
    model = file.model
    found = {}
    for joint in driven:
        if model.jnt_actfrclimited[joint]:
            found[joint] = tuple(model.jnt_actfrcrange[joint])
            continue
        for k in range(model.nactuator):
            if model.actuator_trntype[k] != mujoco.mjtTrn.mjTRN_JOINT:
                continue
            if int(model.actuator_trnid[k, 0]) != joint:
                continue
            gear = float(model.actuator_gear[k, 0])
            if model.actuator_forcelimited[k]:
                found[joint] = tuple(sorted(gear * model.actuator_forcerange[k]))
            elif (
                model.actuator_ctrllimited[k]
                and model.actuator_biastype[k] == mujoco.mjtBias.mjBIAS_NONE
            ):
                force = gear * model.actuator_gainprm[k, 0] * model.actuator_ctrlrange[k]
                found[joint] = tuple(sorted(force))
    return found


def _stated(
    file: ArmFile, numeric: str, driven: tuple[int, ...]
) -> NDArray[np.float64] | str | None:
    """(n,) what the file itself says; None if nothing; a sentence if it cannot be meant."""
    model = file.model
    own = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, numeric)
    if own < 0:
        return None
    start, size = model.numeric_adr[own], model.numeric_size[own]
    values = np.array(model.numeric_data[start : start + size])
    if size not in (model.njnt, len(driven)) or not (np.isfinite(values) & (values > 0)).all():
        return (
            f"{numeric} of the file is {values.tolist()}: allowed is one positive number a joint ({len(driven)} or "
            f"{model.njnt}); not used"
        )
    return values[list(driven)] if size == model.njnt else values
