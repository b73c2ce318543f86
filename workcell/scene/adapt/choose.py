"""Which chain of an arm file becomes the arm, where its tool is, and where the rest is held."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.errors import InputError
from workcell.scene.arm_file import FREE, HINGE, SLIDE, ArmFile, plain
from workcell.scene.normal_form import rigid_links

_TOOL_WORDS = (
    "tool",
    "tcp",
    "attachment",
    "grip",
    "pinch",
    "eef",
    "ee_",
    "end_effector",
    "hand",
    "flange",
)
"""Words of sites that are meant as a tool, the surest first."""


@dataclass(frozen=True)
class Chain:
    """Joints between a root and a tool."""

    root: int
    """Body; 0 for the file's world."""
    bodies: set[int]
    """What is kept: the root and everything below it."""
    driven: tuple[int, ...]
    tool_body: int
    tool_site: int | None
    """None where the tool is a body."""
    tool_name: str
    guessed: tuple[str, ...]

    def root_name(self, file: ArmFile) -> str:
        """Of the root body."""
        return file.bodies[self.root] if self.root else "the file's base"

    def tool_link(self, model: mujoco.MjModel) -> int:
        """First body of the link that carries the tool."""
        return rigid_links(model, self.driven)[self.tool_body]

    def tool_pose_in_world(
        self, file: ArmFile, data: mujoco.MjData, offset_m: tuple[float, float, float]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Position and rotation of the tool."""
        if self.tool_site is None:
            position, rotation = data.xpos[self.tool_body], data.xmat[self.tool_body]
        else:
            position, rotation = data.site_xpos[self.tool_site], data.site_xmat[self.tool_site]
        rotation = rotation.reshape(3, 3).copy()
        return position + rotation @ np.array(offset_m), rotation

    def tool_pose(
        self, file: ArmFile, data: mujoco.MjData, offset_m: tuple[float, float, float]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The same in the frame of the tool's link."""
        position, rotation = self.tool_pose_in_world(file, data, offset_m)
        link = self.tool_link(file.model)
        turn = data.xmat[link].reshape(3, 3)
        return turn.T @ (position - data.xpos[link]), turn.T @ rotation


def name_of(path: Path) -> str:
    """A name for the arm: its file's, or its folder's where the file's says nothing."""
    stem = path.stem if path.stem not in ("robot", "scene", "model", "arm") else path.parent.name
    return re.sub(r"[^a-z0-9]+", "_", stem.lower()).strip("_") or "arm"


def chain(
    file: ArmFile,
    tool: str | None,
    root: str | None,
    locked: dict[str, float],
    *,
    without: tuple[str, ...] = (),
    only: str | None = None,
) -> Chain:
    """The chain from root to tool.

    Args:
        file: The arm file, compiled alone.
        tool: Site or body; None guesses it.
        root: Body where the arm begins; None is the file's base.
        locked: Joints that are held, and where.
        without: Bodies that are left out with all below them.
        only: The one body below the root that is kept, with all below it; nothing of what carries it is.

    Raises:
        InputError: a name is unknown, nothing moves the tool, or a joint of the chain is no hinge or slide.
    """
    model, guessed = file.model, []
    faults = [
        f"--lock {name}: no such joint; allowed: {', '.join(file.joints)}"
        for name in locked
        if plain(name) not in file.joints
    ]
    root_body = 0
    if root is not None:
        if plain(root) in file.bodies:
            root_body = file.bodies.index(plain(root))
        else:
            faults.append(f"--root {root}: no such body; allowed: {', '.join(file.bodies[1:])}")
    bodies = {b for b in range(model.nbody) if root_body in way_up(model, b)}
    for name in without:
        bodies -= {b for b in bodies if file.bodies.index(name) in way_up(model, b)}
    if only is not None:
        bodies = {b for b in bodies if file.bodies.index(only) in way_up(model, b)}
    site, body = None, 0
    if tool is None:
        site, body = _guess_tool(file, bodies)
        name = file.sites[site] if site is not None else file.bodies[body]
        others = [s for s in file.sites if s != name]
        guessed.append(
            f"tool: {'site' if site is not None else 'body'} {name}"
            + (f" (other sites: {', '.join(others[:8])})" if others else "")
        )
    elif plain(tool) in file.sites:
        site = file.sites.index(plain(tool))
        body, name = int(model.site_bodyid[site]), plain(tool)
    elif plain(tool) in file.bodies:
        body, name = file.bodies.index(plain(tool)), plain(tool)
    else:
        faults.append(
            f"--tool {tool}: no such site or body; allowed: {', '.join((*file.sites, *file.bodies[1:]))}"
        )
    if faults:
        raise InputError(faults, file=file.path)
    if body not in bodies:
        raise InputError(f"--tool {name}: is not below --root {root}", file=file.path)
    names = {plain(n) for n in locked}
    driven = [
        j
        for b in way_up(model, body)
        if b != root_body
        for j in range(model.body_jntadr[b], model.body_jntadr[b] + model.body_jntnum[b])
        if file.joints[j] not in names and file.kinds[j] != FREE
    ]
    wrong = [file.joints[j] for j in driven if file.kinds[j] not in (HINGE, SLIDE)]
    if wrong:
        raise InputError(
            f"joint {', '.join(wrong)} on the way to {name} is neither hinge nor slide; hold it where it is (--lock NAME=0) or begin behind it (--root)",
            file=file.path,
        )
    if not driven:
        raise InputError(f"--tool {name}: no joint moves it; choose another", file=file.path)
    return Chain(root_body, bodies, tuple(sorted(driven)), body, site, name, tuple(guessed))


def way_up(model: mujoco.MjModel, body: int) -> list[int]:
    """A body and all that carry it, the world last."""
    way = [body]
    while body:
        body = int(model.body_parentid[body])
        way.append(body)
    return way


def _guess_tool(file: ArmFile, bodies: set[int]) -> tuple[int | None, int]:
    """A site that is called like a tool, the surest word first, then the most joints; else the last body."""
    model = file.model

    def joints(body: int) -> int:
        return int(sum(model.body_jntnum[b] for b in way_up(model, body)))

    for word in _TOOL_WORDS:
        named = [
            s
            for s in range(model.nsite)
            if word in file.sites[s].lower()
            and int(model.site_bodyid[s]) in bodies
            and joints(int(model.site_bodyid[s])) > 0
        ]
        if named:
            site = max(named, key=lambda s: (joints(int(model.site_bodyid[s])), -s))
            return site, int(model.site_bodyid[site])
    for word in _TOOL_WORDS:
        hands = [b for b in bodies if word in file.bodies[b].lower() and joints(b) > 0]
        if hands:
            return None, max(hands, key=lambda b: (joints(b), -b))
    return None, max(bodies, key=lambda b: (joints(b), -b))


def start(
    file: ArmFile, chosen: Chain, locked: dict[str, float]
) -> tuple[NDArray[np.float64], list[str]]:
    """(nq,) where every joint of the file stands, and what is said of the locked ones."""
    model = file.model
    qpos = model.qpos0.copy()
    if model.nkey:
        names = [model.key(k).name for k in range(model.nkey)]
        qpos = model.key_qpos[names.index("home") if "home" in names else 0].copy()
    for joint in np.flatnonzero(model.jnt_limited):
        if file.kinds[joint] in (HINGE, SLIDE):
            address = model.jnt_qposadr[joint]
            qpos[address] = np.clip(qpos[address], *model.jnt_range[joint])
    for name, value in locked.items():
        joint = file.joints.index(plain(name))
        if file.kinds[joint] in (HINGE, SLIDE):
            qpos[model.jnt_qposadr[joint]] = value
        elif value != 0.0:
            raise InputError(
                f"--lock {name}={value:g}: is of type {file.kinds[joint]}, which is held where the file puts it; allowed is 0",
                file=file.path,
            )
    held = [
        f"{file.joints[j]} = {qpos[model.jnt_qposadr[j]]:.4g}"
        for j in range(model.njnt)
        if j not in chosen.driven and int(model.jnt_bodyid[j]) in chosen.bodies
    ]
    said = [f"locked, mass and geometry merged: {', '.join(held)}"] if held else []
    left = set(range(1, model.nbody)) - chosen.bodies - {chosen.root}
    if left:
        said.append(f"{len(left)} bodies that are no part of this arm are left out")
    return qpos, said
