"""What an arm file lacks, all at once, in the order in which to mend it, and what `import` would mend."""

from __future__ import annotations

import itertools
import time
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
from workcell.scene.coverage import (
    WATCHED_GROUP,
    Links,
    bare_housing,
    sampled_links,
    watched_geoms,
)
from workcell.scene.normal_form import rigid_links
from workcell.scene.servos import servo_of

TIMES = 20
"""How often distances are measured for their cost."""
FAR_M = 100.0
"""Beyond the size of any cell, as in a run."""
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
    links = sampled_links(file.model, rigid_links(file.model, chain.driven), qpos, chain.driven)
    told += [*_assumed(file), _cost(file.model, links), *file.neutralised]
    return [*_missing(file, chain, links)], told


def _missing(file: ArmFile, chain: choose.Chain, links: Links) -> Iterator[str]:
    model = file.model
    if chain.tool_site is None:
        yield f"no site is the tool; give {chain.tool_name} a site{MENDED}"
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


def _cost(model: mujoco.MjModel, links: Links) -> str:
    """How many pairs two such arms have between them, and what their distances cost."""
    watched = watched_geoms(links)
    standing = sum(links.of_body[model.geom_bodyid[g]] == 0 for g in watched)
    pairs = len(watched) ** 2 - standing**2
    between = list(itertools.combinations(watched, 2))
    if not between:
        return f"two such arms have {pairs} watched pairs between them"
    started = time.perf_counter()
    for _ in range(TIMES):
        for g, h in between:
            mujoco.mj_geomDistance(model, links.poses[0], g, h, FAR_M, None)
    a_pair_s = (time.perf_counter() - started) / TIMES / len(between)
    return (
        f"two such arms have {pairs} watched pairs between them, beside those of each with itself; here their distances "
        f"take {1e3 * pairs * a_pair_s:.2f} ms of every tick"
    )


def _assumed(file: ArmFile) -> Iterator[str]:
    for numeric in (VELOCITY_LIMIT_NUMERIC, ACCELERATION_LIMIT_NUMERIC):
        own = mujoco.mj_name2id(file.model, mujoco.mjtObj.mjOBJ_NUMERIC, numeric)
        if own < 0:
            yield f"{numeric}: not stated, a slow default is assumed{MENDED}"
        else:
            start, size = file.model.numeric_adr[own], file.model.numeric_size[own]
            values = file.model.numeric_data[start : start + size]
            yield f"{numeric}, in force: {', '.join(f'{x:g}' for x in values)}"
