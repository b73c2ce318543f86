"""Watched pairs on any MuJoCo model: which geoms, how far apart, how fast, how soon.

In: an `MjModel` as it is, or an `MjSpec`, to which distance sensors are added before it is compiled (MuJoCo then
finds all witness points in one call; the numbers are the same). Out: `Proximity` with distances and their rows,
`PairTimes` with rates and times to collision (docs/theory.md sections 1 to 4).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from workcell.control.finite import at_least_zero, vector
from workcell.control.proximity import PairGeometry, Proximity
from workcell.control.second_order import second_order
from workcell.control.ttc import (
    SmallestTtc,
    reciprocal_first_order,
    reciprocal_second_order,
    smallest,
)
from workcell.errors import InputError, did_you_mean, shown
from workcell.scene.pairs import SENSOR_CUTOFF_M

Array = NDArray[np.float64]
Geom = str | int
"""A geom by its name or its id."""

SENSOR_PREFIX = "watched_pair_"
"""Names of the sensors that are added to an `MjSpec`, before their number."""


@dataclass(frozen=True)
class PairTimes:
    """How soon the pairs would meet; P pairs."""

    distance_m: Array
    """(P,) surface distances, negative when penetrating."""
    rate_m_s: Array
    """(P,) their rates, negative when closing."""
    ttc_s: Array
    """(P,) times to collision; infinite where a pair does not close."""
    first: SmallestTtc
    """The pair that would meet first."""


class PairWatch(PairGeometry):
    """Watches pairs of geoms of a model.

    Args:
        model: A compiled model, which is not changed; or a specification, which is given a distance sensor a pair
            and compiled into `model`.
        pairs: Geoms of each pair, by name or id: spheres, capsules, planes, boxes, cylinders, ellipsoids and meshes
            (convex hulls).

    Raises:
        InputError: A geom is unknown or a pair cannot be measured; all faults at once.
    """

    def __init__(self, model: mujoco.MjModel | mujoco.MjSpec, pairs: Iterable[tuple[Geom, Geom]]):
        listed = [tuple(pair) for pair in pairs]
        if isinstance(model, mujoco.MjSpec):
            compiled, addresses = _with_sensors(model, listed)
            super().__init__(compiled, _ids(compiled, listed), addresses)
        else:
            super().__init__(model, _ids(model, listed))
        self._compiled_here = isinstance(model, mujoco.MjSpec)

    def look(self, data: mujoco.MjData) -> Proximity:
        """Distances, directions, witness points and rows at `data.qpos`; brings kinematics and sensors up to date.

        Raises:
            InputError: The data are of another model.
            WorkcellError: A result is not finite.
        """
        self._require_own(data)
        mujoco.mj_kinematics(self.model, data)
        mujoco.mj_comPos(self.model, data)
        if self.has_sensors:
            mujoco.mj_sensorPos(self.model, data)
        return self.measure(data)

    def times(
        self,
        data: mujoco.MjData,
        *,
        qvel: ArrayLike | None = None,
        order: int = 1,
        qacc: ArrayLike | None = None,
        standoff_m: float = 0.0,
    ) -> PairTimes:
        """Times to collision at `data.qpos`.

        Args:
            data: Of the watched model; kinematics and sensors are brought up to date.
            qvel: (nv,) joint velocities; those of the data if left out.
            order: 1: -d/d'; 2: with the second derivative of the distance, joint accelerations as given.
            qacc: (nv,) joint accelerations, for order 2 only; zero if left out.
            standoff_m: Distance to which the time is counted.

        Raises:
            InputError: A value has another shape or is out of range.
        """
        if order not in (1, 2):
            raise InputError(f"order is {shown(order)}; allowed is 1 or 2")
        at_least_zero("standoff_m", standoff_m)
        if qacc is not None and order == 1:
            raise InputError("qacc is given, and order is 1; accelerations count with order = 2")
        nv = self.model.nv
        velocity = vector("qvel", data.qvel if qvel is None else qvel, nv)
        accel = np.zeros(nv) if qacc is None else vector("qacc", qacc, nv)
        near = self.look(data)
        rate = near.rate_m_s(velocity)
        if order == 1:
            kappa = reciprocal_first_order(near.distance_m, rate, standoff_m=standoff_m)
        else:
            kept, data.qvel[:] = data.qvel.copy(), velocity
            mujoco.mj_comVel(self.model, data)
            second = second_order(self, data, near, accel).accel_m_s2
            data.qvel[:] = kept
            kappa = reciprocal_second_order(near.distance_m, rate, second, standoff_m=standoff_m)
        with np.errstate(divide="ignore"):
            ttc_s = np.where(kappa > 0.0, 1.0 / kappa, np.inf)
        return PairTimes(near.distance_m, rate, ttc_s, smallest(kappa))

    def _require_own(self, data: mujoco.MjData) -> None:
        sizes = len(data.qpos), len(data.qvel), len(data.geom_xpos), len(data.sensordata)
        model = self.model
        if sizes != (model.nq, model.nv, model.ngeom, model.nsensordata):
            advice = "make them with mujoco.MjData(watch.model)" if self._compiled_here else ""
            raise InputError(f"the data are not of the watched model; {advice}".rstrip("; "))


def pairs_between(
    model: mujoco.MjModel | mujoco.MjSpec,
    first: str | Sequence[str],
    second: str | Sequence[str],
    *,
    group: int | None = None,
) -> list[tuple[int, int]]:
    """Geom ids of all pairs between the geoms of some bodies and those of others, whatever their contact bits.

    Args:
        model: The model.
        first, second: Names of bodies; each stands for itself and all that hangs on it. `world` stands for the
            geoms fixed to the world body itself.
        group: Geoms of this group alone; of all groups if left out.

    Returns:
        Pairs that some joint moves against each other; the others never change.

    Raises:
        InputError: A body is unknown, or a side has no geoms.
    """
    if isinstance(model, mujoco.MjSpec):
        model = model.copy().compile()
    sides = [_geoms_of(model, names, group) for names in (first, second)]
    moved = _moving(model)
    return [
        (i, j)
        for i in sides[0]
        for j in sides[1]
        if i != j and moved[int(model.geom_bodyid[i])] != moved[int(model.geom_bodyid[j])]
    ]


def _geoms_of(model: mujoco.MjModel, names: str | Sequence[str], group: int | None) -> list[int]:
    listed = [names] if isinstance(names, str) else list(names)
    known = [model.body(b).name for b in range(model.nbody)]
    faults = [
        f"body {name!r} is unknown{did_you_mean(name, known)}"
        for name in listed
        if name not in known
    ]
    if faults:
        raise InputError(faults)
    roots = {known.index(name) for name in listed}
    found = []
    for g in range(model.ngeom):
        body = int(model.geom_bodyid[g])
        above = {body}
        while body:
            body = int(model.body_parentid[body])
            above.add(body)
        # What hangs on the world is everything: of it, only its own geoms are meant.
        at_home = bool((above - {0}) & roots) or (0 in roots and int(model.geom_bodyid[g]) == 0)
        if at_home and group in (None, int(model.geom_group[g])):
            found.append(g)
    if not found:
        which = "" if group is None else f" in group {group}"
        raise InputError(f"{', '.join(listed)}: has no geoms{which}")
    return found


def _moving(model: mujoco.MjModel) -> list[frozenset[int]]:
    """For every body the joint velocities that move it."""
    moved: list[frozenset[int]] = [frozenset()]
    for body in range(1, model.nbody):
        start = int(model.body_dofadr[body])
        own = range(start, start + int(model.body_dofnum[body]))
        moved.append(moved[int(model.body_parentid[body])] | frozenset(own))
    return moved


def _ids(model: mujoco.MjModel, pairs: Sequence[tuple[Geom, ...]]) -> list[tuple[int, int]]:
    """Pairs of geom ids."""
    names = [model.geom(g).name for g in range(model.ngeom)]
    faults: list[str] = []
    found = []
    if not pairs:
        raise InputError("pairs is empty; at least one pair is needed")
    for k, pair in enumerate(pairs):
        if len(pair) != 2:
            raise InputError(f"pairs[{k}] has {len(pair)} geoms; allowed is 2")
        ids = []
        for geom in pair:
            if isinstance(geom, str) and geom in names:
                ids.append(names.index(geom))
            elif isinstance(geom, str):
                faults.append(f"pairs[{k}]: geom {geom!r} is unknown{did_you_mean(geom, names)}")
            elif isinstance(geom, (int, np.integer)) and 0 <= geom < model.ngeom:
                ids.append(int(geom))
            else:
                faults.append(
                    f"pairs[{k}]: geom {shown(geom)}; allowed is a name or an id from 0 to {model.ngeom - 1}"
                )
        if len(ids) == 2:
            found.append((ids[0], ids[1]))
    if faults:
        raise InputError(faults)
    return found


def _with_sensors(
    spec: mujoco.MjSpec, pairs: Sequence[tuple[Geom, ...]]
) -> tuple[mujoco.MjModel, list[int]]:
    """The specification compiled with a `fromto` sensor for each pair, and where each writes."""
    bare = spec.copy().compile()
    names = {sensor.name for sensor in spec.sensors}
    added = []
    for i, j in _ids(bare, pairs):
        ends = [bare.geom(g).name for g in (i, j)]
        if not all(ends):
            raise InputError(
                f"geom {i if not ends[0] else j} has no name, which a sensor needs; name it, or give the compiled model"
            )
        name = next(
            f"{SENSOR_PREFIX}{k}"
            for k in range(len(names), 10**9)
            if f"{SENSOR_PREFIX}{k}" not in names
        )
        names.add(name)
        added.append(name)
        spec.add_sensor(
            name=name,
            type=mujoco.mjtSensor.mjSENS_GEOMFROMTO,
            objtype=mujoco.mjtObj.mjOBJ_GEOM,
            objname=ends[0],
            reftype=mujoco.mjtObj.mjOBJ_GEOM,
            refname=ends[1],
            cutoff=SENSOR_CUTOFF_M,
        )
    model = spec.compile()
    return model, [int(model.sensor(name).adr[0]) for name in added]
