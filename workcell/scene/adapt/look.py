"""What an arm file lacks, all at once, in the order in which to mend it, and what `import` would mend."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np

from workcell.scene.adapt import choose
from workcell.scene.adapt.source import read
from workcell.scene.arm_file import (
    ACCELERATION_LIMIT_NUMERIC,
    VELOCITY_LIMIT_NUMERIC,
    ArmFile,
)
from workcell.scene.coverage import WATCHED_GROUP, bare_housing, sampled_links, watched_geoms
from workcell.scene.normal_form import rigid_links
from workcell.scene.servos import servo_of

MENDED = " (`workcell import` mends this)"


def look(path: Path, tool: str | None = None) -> tuple[list[str], list[str]]:
    """What must be mended, and what is worth knowing.

    Raises:
        InputError: the file does not compile, or nothing in it can be an arm.
    """
    file = read(path)
    chain = choose.chain(file, tool, None, {})
    qpos, said = choose.start(file, chain, {})
    names = ", ".join(file.joints[j] for j in chain.driven)
    told = [f"{len(chain.driven)} joints move {chain.tool_name}: {names}", *chain.guessed, *said]
    told += [*_assumed(file), *file.neutralised]
    return [*_missing(file, chain, qpos)], told


def _missing(file: ArmFile, chain: choose.Chain, qpos: np.ndarray) -> Iterator[str]:
    model = file.model
    if chain.tool_site is None:
        yield f"no site is the tool; give {chain.tool_name} a site{MENDED}"
    links = sampled_links(model, rigid_links(model, chain.driven), qpos, chain.driven)
    capsules = model.geom_group == WATCHED_GROUP
    with_capsules = {links.of_body[model.geom_bodyid[g]] for g in np.flatnonzero(capsules)}
    watched = watched_geoms(links)
    for link in bare_housing(links, watched, (file.bodies, file.geoms)):
        first = links.of_body[file.bodies.index(link.link)] if link.link in file.bodies else 0
        if first not in with_capsules:
            yield f"{link.link}: no capsules (group 4), its geoms are watched as they are: slower{MENDED}"
        elif link.outside_m > 1e-3:
            yield f"{link.link}: housing {link.geom} reaches {1e3 * link.outside_m:.1f} mm out of its capsules{MENDED}"
    for joint in chain.driven:
        servo = servo_of(model, joint)
        if isinstance(servo, str):
            yield f"{file.joints[joint]}: {servo}; the dynamic plant needs one{MENDED}"
    heavy = [
        file.bodies[b]
        for b in range(1, model.nbody)
        if model.body_mass[b] > 0 and model.body_gravcomp[b] == 0 and links.of_body[b]
    ]
    if heavy:
        yield f"gravity is not compensated for {', '.join(heavy)}: servos sag on the dynamic plant{MENDED}"


def _assumed(file: ArmFile) -> Iterator[str]:
    for numeric in (VELOCITY_LIMIT_NUMERIC, ACCELERATION_LIMIT_NUMERIC):
        if mujoco.mj_name2id(file.model, mujoco.mjtObj.mjOBJ_NUMERIC, numeric) < 0:
            yield f"{numeric}: not stated, a slow default is assumed{MENDED}"
