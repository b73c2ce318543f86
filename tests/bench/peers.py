"""What the libraries beside us are given: one scene, one list of pairs, one program, the same states.

    scene     the cell's bodies, joints and watched geoms as an MJCF file that every parser reads
    wishes    states of a run, and how fast both tools are to move from there
    program   minimise  |v|² + TOOL_WEIGHT Σ |J v - V|²   over the joint velocities v of both arms
              subject to  |v| <= joint speed limits,  G v >= -d / t_min  for every pair

The tool is a cost, since Drake and cbfpy know no task as an equality; every task is on the tool's
body. Only the speed limit is asked of the joints: it is the one that all of them mean alike.
A peer answers in our order of pairs and joints.
"""

from __future__ import annotations

import importlib
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import daqp
import mujoco
import numpy as np
import pytest

from tests.bench.conftest import State, Stopwatch
from workcell.scene.cell import Cell

T_MIN_S = 1.0
EVERYTHING_M = 10.0
"""Detection distance at which no pair of the cell is left out."""
TOOL_WEIGHT = 1e4
"""Of the tool against joint motion: the tool gives way by some 1e-4. Drake advises 100 or more."""
HURRY = 2.0
"""The tools are asked to move this many times as fast as in the run: then pairs bind at t_min."""


@dataclass(frozen=True)
class Library:
    """What a peer needs, and how well it is known to do; the last three are what the benchmarks hold it to."""

    package: str
    """To be installed."""
    modules: tuple[str, ...]
    versions: tuple[str, ...]
    """Packages whose versions are told."""
    distance_m: float
    """Largest error of a distance."""
    row_m_per_rad: float
    """Largest error of an entry of a row."""
    undercut_m: float
    """By how much d + G v t_min of its answer may fall below 0."""


PEERS = {
    "pink": Library(
        "pin-pink", ("pink", "pinocchio"), ("pin-pink", "pin", "coal"), 1e-8, 1e-6, 1e-6
    ),
    # Nearest points of capsules come from an iteration that ends at 0.1 mm, and OSQP ends early too.
    "drake": Library("drake", ("pydrake",), ("drake",), 2e-4, 0.1, 1e-3),
    "cbfpy": Library("cbfpy", ("cbfpy", "jax"), ("cbfpy", "qpax", "jax"), 1e-9, 1e-6, 1e-6),
}

Rows = tuple[np.ndarray, np.ndarray]
"""Distances (P,) and their Jacobian (P, nv)."""


@dataclass(frozen=True)
class Wish:
    """A state and what is wanted there."""

    qpos: np.ndarray
    twist: np.ndarray
    """(A, 6) angular, then linear velocity of each tool body's frame, in the world."""
    target: np.ndarray
    """(A, 4, 4) where that takes the frames within a tick."""


@dataclass(frozen=True)
class Problem:
    """What a peer is built from."""

    mjcf: Path
    pairs: tuple[tuple[str, str], ...]
    joints: tuple[str, ...]
    tools: tuple[str, ...]
    """Bodies of the tools, an arm each."""
    speed_rad_s: np.ndarray
    """(nv,) joint speed limits."""
    period_s: float
    t_min_s: float = T_MIN_S


class Peer(Protocol):
    """A library that does the same."""

    def distances(self, qpos: np.ndarray) -> np.ndarray:
        """Distances (P,)."""
        ...

    def rows(self, qpos: np.ndarray) -> Rows:
        """Distances (P,) and Jacobian (P, nv)."""
        ...

    def step(self, wish: Wish) -> np.ndarray:
        """Joint velocities (nv,) that solve the program."""
        ...


def peer(name: str, problem: Problem) -> Peer:
    """Build a peer, or skip by its name where it is not installed."""
    library = PEERS[name]
    for module in library.modules:
        pytest.importorskip(
            module,
            reason=f"{name} is not measured: {library.package} is not installed "
            "(pip install --group peers, from the repository)",
        )
    return importlib.import_module(f"tests.bench.peers_{name}").build(problem)


def problem(cell: Cell, folder: Path) -> Problem:
    """The cell as the others read it; `folder` holds its scene.xml."""
    model = cell.model
    speed = np.zeros(model.nv)
    for arm in cell.arms:
        speed[arm.dofs] = arm.velocity_limit_rad_s
    return Problem(
        mjcf=_plain_scene(cell, folder),
        pairs=cell.pairs.names,
        joints=tuple(model.joint(j).name for j in range(model.njnt)),
        tools=tuple(model.body(b).name for b in _tool_bodies(cell)),
        speed_rad_s=speed,
        period_s=cell.period_s,
    )


def wishes(cell: Cell, states: Sequence[State]) -> list[Wish]:
    """What is wanted in each state: the tools' own motion, but faster."""
    data, found = mujoco.MjData(cell.model), []
    for qpos, qvel in states:
        data.qpos[:], data.qvel[:] = qpos, qvel
        mujoco.mj_kinematics(cell.model, data)
        mujoco.mj_comPos(cell.model, data)
        twists = HURRY * (tool_jacobian(cell, data) @ qvel).reshape(-1, 6)
        targets = [
            _moved(data.xpos[body], data.xquat[body], twist * cell.period_s)
            for body, twist in zip(_tool_bodies(cell), twists, strict=True)
        ]
        found.append(Wish(qpos, twists, np.array(targets)))
    return found


def exact(problem: Problem, wish: Wish, jacobian: np.ndarray, rows: Rows) -> np.ndarray:
    """The program's solution (nv,), from our rows and the Jacobian of all tools, (6 A, nv)."""
    distance, G = rows
    n, speed = len(problem.speed_rad_s), problem.speed_rad_s
    velocity, _, flag, _ = daqp.solve(
        np.eye(n) + TOOL_WEIGHT * jacobian.T @ jacobian,
        -TOOL_WEIGHT * jacobian.T @ wish.twist.ravel(),
        np.ascontiguousarray(G),
        np.concatenate([speed, np.full(len(distance), np.inf)]),
        np.concatenate([-speed, -distance / problem.t_min_s]),
        np.zeros(n + len(distance), dtype=np.intc),
        primal_tol=1e-10,
        dual_tol=1e-10,
    )
    assert flag == 1
    return velocity


def tool_jacobian(cell: Cell, data: mujoco.MjData) -> np.ndarray:
    """(6 A, nv) angular, then linear, of each tool's body in the world."""
    parts = []
    for body in _tool_bodies(cell):
        turn, move = np.empty((2, 3, cell.model.nv))
        mujoco.mj_jacBody(cell.model, data, move, turn, body)
        parts += [turn, move]
    return np.concatenate(parts)


def _tool_bodies(cell: Cell) -> list[int]:
    return [int(cell.model.site_bodyid[arm.tool_site]) for arm in cell.arms]


def _moved(position: np.ndarray, wxyz: np.ndarray, step: np.ndarray) -> np.ndarray:
    """A frame turned and shifted by a small step in the world, as a 4 x 4 matrix."""
    angle = float(np.linalg.norm(step[:3]))
    turn, new, rotation = np.empty(4), np.empty(4), np.empty(9)
    mujoco.mju_axisAngle2Quat(turn, step[:3] / angle if angle else np.array([0.0, 0.0, 1.0]), angle)
    mujoco.mju_mulQuat(new, turn, wxyz)
    mujoco.mju_quat2Mat(rotation, new)
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = rotation.reshape(3, 3), position + step[3:]
    return frame


def _plain_scene(cell: Cell, folder: Path) -> Path:
    """scene.xml as text, less what a parser stumbles over; no length or angle in it is touched.

    Kept are bodies, joints and the watched geoms. What is changed: the geoms get contact bits,
    without which Drake and Pinocchio drop them from collision geometry; what stands gets a fixed body
    each, as Drake tells rows apart by body; and all of it one fixed body as parent, as Pinocchio
    reads no more than the first tree of a world.
    """
    watched = {name for pair in cell.pairs.names for name in pair}
    tree = ET.parse(folder / "scene.xml")
    root = tree.getroot()
    for part in list(root):
        if part.tag not in ("compiler", "default", "worldbody"):
            root.remove(part)
    for part in root.iter():
        # Drives are of no concern here, and Drake warns of each that it does not know.
        for key in ("gravcomp", "actuatorgravcomp", "actuatorfrcrange", "material"):
            part.attrib.pop(key, None)
        for child in list(part):
            unwatched = child.tag == "geom" and "name" in child.attrib
            unwatched = unwatched and child.get("name") not in watched
            if unwatched or child.tag in ("site", "light", "camera"):
                part.remove(child)
            elif child.tag == "geom":
                child.set("contype", "1")
                child.set("conaffinity", "1")
    world = root.find("worldbody")
    assert world is not None
    parts = list(world)
    parent = ET.SubElement(world, "body", name="cell")
    for part in parts:
        world.remove(part)
        holder = (
            ET.SubElement(parent, "body", name=part.get("name", ""))
            if part.tag == "geom"
            else parent
        )
        holder.append(part)
    file = folder / "plain.xml"
    tree.write(file)
    return file


class ProcessStopwatch(Stopwatch):
    """Counts the processor time of all threads: JAX computes in others than the one that asks."""

    def time(self, function: Callable[..., object], *arguments, **keywords):
        wall, cpu = time.perf_counter_ns(), time.process_time_ns()
        try:
            return function(*arguments, **keywords)
        finally:
            self._cpu.append(time.process_time_ns() - cpu)
            self._wall.append(time.perf_counter_ns() - wall)
