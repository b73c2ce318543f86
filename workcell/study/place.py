"""Where must an arm stand so that it can do what it is to do? A search of base poses and homes by rehearsal.

In: a scenario that may be far from one that can be run. Out: the same with other bases or homes of those arms whose
rehearsal fails, found by differential evolution (scipy), seeded, from where they stand now. What is found is a layout
with room; whether the run then goes as expected is for the run to say.
"""

from __future__ import annotations

import contextlib
import copy
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution, minimize

from workcell.scenario import Scenario
from workcell.scene import cell as scene
from workcell.scene.addresses import ArmAddresses, arm_of_geom
from workcell.scene.cell import Cell
from workcell.study.rehearsal import Rehearsal, rehearse

ROOM = 1.5
"""Room wanted of everything that is not to meet, in units of `control.d_min_m`."""
BASE_M = 0.6
"""How far a base is moved at most, in x and in y."""
HOME_RAD = 1.2
"""How far a joint's home is moved at most."""
EVALUATIONS = 600
"""Rehearsals of a search, to which half as many come that polish what it found; each takes 10 to 50 ms."""
_CANDIDATES = 20
"""Of a generation of the search."""
_INSIDE_M = 0.1
"""What a base that stands inside something counts as, m."""


@dataclass(frozen=True)
class Move:
    """Where an arm went."""

    arm: str
    position_m: tuple[float, ...] | None
    """None where the base stays."""
    wxyz: tuple[float, ...] | None
    home_rad: tuple[float, ...] | None
    """None where the home stays."""
    before: Rehearsal
    after: Rehearsal
    evaluations: int


def place(
    asked: Scenario,
    *,
    search: str = "both",
    evaluations: int = EVALUATIONS,
    say: Callable[[str], None] = lambda text: None,
) -> tuple[Move, ...]:
    """Search a place for every arm whose rehearsal fails.

    Args:
        asked: The scenario.
        search: `base`, `home`, or `both`: the base first, then both together.
        evaluations: Largest number of rehearsals of a search.
        say: Told what is being looked at.

    Returns:
        One move for each arm that was looked for, whether a fitting place was found or not.

    Raises:
        InputError: the cell cannot be built.
    """
    with tempfile.TemporaryDirectory() as folder:
        built = scene.build(asked, Path(folder))
    # The search moves bases in a model of its own.
    cell = replace(built, model=copy.copy(built.model))
    room_m = ROOM * asked.control.d_min_m
    moves = []
    # An arm of low priority goes out of the way of the others, not they out of its.
    order = sorted(
        range(len(cell.arms)), key=lambda k: (not cell.arms[k].support, -cell.arms[k].priority)
    )
    for index in order:
        arm = cell.arms[index]
        before = rehearse(cell, arm, room_m)
        say(f"{arm.name}: {told(before)}")
        if before.fits:
            continue
        best: _Found | None = None
        for what in {"base": ["base"], "home": ["home"]}.get(search, ["base", "base and home"]):
            found = _search(cell, index, room_m, what, evaluations)
            say(f"{arm.name}: {what}: {told(found.rehearsal)} after {found.evaluations} rehearsals")
            if best is None or found.cost < best.cost:
                best = found
            if found.rehearsal.fits:
                break
        assert best is not None
        moves.append(_take(cell, index, best, before))
        cell = replace(cell, arms=tuple(best.arm if a is arm else a for a in cell.arms))
    return tuple(moves)


def told(found: Rehearsal) -> str:
    """A rehearsal in words."""
    if found.fits:
        return "all within reach and clear"
    parts = []
    if found.missed_m:
        parts.append(f"the tool stays {found.missed_m:.3f} m away at its {found.missed_at}")
    if found.near_pair is not None:
        one, other = found.near_pair
        parts.append(f"{one} and {other} lack {found.near_m:.3f} m of room")
    return ", ".join(parts)


@dataclass(frozen=True)
class _Found:
    """A place."""

    cost: float
    rehearsal: Rehearsal
    arm: ArmAddresses
    position_m: NDArray[np.float64]
    wxyz: NDArray[np.float64]
    evaluations: int


class _Fits(Exception):
    """A place fits: nothing better is looked for."""


def _search(cell: Cell, index: int, room_m: float, what: str, evaluations: int) -> _Found:
    """The best place of one arm; the model is left with the arm there."""
    model, arm = cell.model, cell.arms[index]
    base = model.body(f"{arm.name}/").id
    start_m, start_wxyz = model.body_pos[base].copy(), model.body_quat[base].copy()
    moves_base, moves_home = "base" in what, "home" in what
    low = np.maximum(arm.lower_rad, arm.home_rad - HOME_RAD)
    high = np.minimum(arm.upper_rad, arm.home_rad + HOME_RAD)
    stood = _standing_in(cell, arm.name)
    bounds = [(-BASE_M, BASE_M), (-BASE_M, BASE_M), (-np.pi, np.pi)] * moves_base
    bounds += list(zip(low, high, strict=True)) * moves_home
    first = [0.0, 0.0, 0.0] * moves_base + arm.home_rad.tolist() * moves_home
    best: list[_Found] = []
    count = 0

    def cost(values: NDArray[np.float64]) -> float:
        nonlocal count
        count += 1
        tried = arm
        if moves_base:
            model.body_pos[base] = start_m + np.array([values[0], values[1], 0.0])
            turn = np.array([np.cos(values[2] / 2), 0.0, 0.0, np.sin(values[2] / 2)])
            mujoco.mju_mulQuat(model.body_quat[base], turn, start_wxyz)
        if moves_home:
            tried = replace(arm, home_rad=values[3 * moves_base :].copy())
        arms = tuple(tried if k == index else other for k, other in enumerate(cell.arms))
        limit = best[-1].cost if best else np.inf
        rehearsal = rehearse(replace(cell, arms=arms), tried, room_m, give_up_m=limit)
        inside = len(_standing_in(cell, arm.name) - stood)
        found = rehearsal.missed_m + rehearsal.near_m + rehearsal.total / max(rehearsal.looks, 1)
        found += _INSIDE_M * inside
        if not best or found < best[-1].cost:
            best.append(_Found(found, rehearsal, tried, model.body_pos[base].copy(), model.body_quat[base].copy(), count))  # fmt: skip
        if rehearsal.fits and not inside:
            raise _Fits
        return found

    generations = max(1, evaluations // _CANDIDATES - 1)
    population = _latin(bounds, first)
    with contextlib.suppress(_Fits):
        # SciPy's stubs know neither an array as `init` nor `seed`.
        search: Any = differential_evolution
        found = search(
            cost, bounds, init=population, maxiter=generations, seed=0, polish=False, tol=0.0
        )
        # The last millimetres are found from the best place, by an optimiser that needs no slopes.
        minimize(
            cost, found.x, method="Nelder-Mead", bounds=bounds, options={"maxfev": evaluations // 2}
        )
    found = replace(best[-1], evaluations=count)
    model.body_pos[base], model.body_quat[base] = found.position_m, found.wxyz
    return found


def _latin(bounds: list[tuple[float, float]], first: list[float]) -> NDArray[np.float64]:
    """(candidates, n) spread over the bounds, half of them near the first, the first among them."""
    rng = np.random.default_rng(0)
    low, high = np.array(bounds).T
    n = len(first)
    ranks = np.array([rng.permutation(_CANDIDATES) for _ in range(n)]).T
    spread = low + (high - low) * (ranks + rng.random((_CANDIDATES, n))) / _CANDIDATES
    near = _CANDIDATES // 2
    spread[:near] = np.array(first) + 0.3 * (spread[:near] - np.array(first))
    spread[0] = first
    return np.clip(spread, low, high)


def _standing_in(cell: Cell, name: str) -> frozenset[tuple[int, int]]:
    """Pairs of what stands of an arm and of something else, the floor apart, that overlap."""
    model, names = cell.model, tuple(arm.name for arm in cell.arms)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    still = np.flatnonzero(model.body_weldid[model.geom_bodyid] == 0).tolist()
    owner = {g: arm_of_geom(model, g, names) for g in still}
    own = [g for g in still if owner[g] == name]
    others = [g for g in still if owner[g] != name and model.geom(g).name != "floor"]
    return frozenset(
        (g, h)
        for g in own
        for h in others
        if mujoco.mj_geomDistance(model, data, g, h, 1.0, None) <= 0.0
    )


def _take(cell: Cell, index: int, found: _Found, before: Rehearsal) -> Move:
    """A place as numbers of a scenario file."""
    settings, arm = cell.scenario.arm[index], found.arm
    position = tuple(round(float(x), 4) for x in found.position_m)
    wxyz = tuple(round(float(x), 9) for x in found.wxyz)
    home = tuple(round(float(q), 4) for q in arm.home_rad)
    moved_base = position != tuple(round(x, 4) for x in settings.base_position_m) or not np.allclose(wxyz, settings.base_wxyz, atol=1e-6)  # fmt: skip
    moved_home = arm is not cell.arms[index]
    return Move(
        arm.name,
        position if moved_base else None,
        wxyz if moved_base else None,
        home if moved_home else None,
        before,
        found.rehearsal,
        found.evaluations,
    )
