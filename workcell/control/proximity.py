"""Distances of watched geom pairs and their Jacobian (docs/theory.md sections 1, 2).

In: a MuJoCo model whose `fromto` sensors hold the witness points of each pair, and data on which
kinematics and sensors were computed. Out: signed distance d, direction n, witness points, the
Jacobian G = dd/dq of every pair (paper equations 3 to 5). All pairs are treated at once: in compiled
code where there is any (`kernels`), else in what is written here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from workcell.control.finite import all_finite, finite
from workcell.control.kernels.arguments import DONE
from workcell.control.kernels.library import Bound, Kernels, kernels
from workcell.errors import InputError, WorkcellError

Array = NDArray[np.float64]

CROSSING_TOLERANCE_M = 1e-9
"""Axis distance below which two axes count as crossing.

Witness points are good to about 1e-16 m, so at 1e-9 m their direction has seven digits left.
"""
COINCIDENT_TOLERANCE_M = 1e-9
"""Distance below which the witness points of two geoms without a radius give no direction."""

SURFACE_TOLERANCE_M = 1e-6
"""How far the surface point of a round geom may be off its surface.

Measured against boxes, cylinders, ellipsoids and meshes, 6000 poses each: at most 2e-8 m while
the axis is outside. Beyond the tolerance the axis is inside the other geom.
"""
CROSSING_PARALLEL_SINE = 1e-6
"""Sine of the angle below which crossing axes have no common perpendicular worth its digits."""

_GEOM = mujoco.mjtGeom
_ROUND = (_GEOM.mjGEOM_SPHERE, _GEOM.mjGEOM_CAPSULE)
_FLAT = (
    _GEOM.mjGEOM_PLANE,
    _GEOM.mjGEOM_BOX,
    _GEOM.mjGEOM_CYLINDER,
    _GEOM.mjGEOM_ELLIPSOID,
    _GEOM.mjGEOM_MESH,
)


@dataclass(frozen=True)
class Proximity:
    """The state of all watched pairs (i, j) at one configuration, in the world frame."""

    distance_m: Array
    """Signed surface distance (P,), negative when penetrating."""
    normal: Array
    """Unit vector n (P, 3) from j to i."""
    witness_i_m: Array
    """Witness point on i (P, 3): on the axis of a sphere or capsule, else on the surface."""
    witness_j_m: Array
    """Witness point on j (P, 3), likewise."""
    surface_i_m: Array
    """Nearest surface point of i (P, 3), for drawing."""
    surface_j_m: Array
    """Nearest surface point of j (P, 3), for drawing."""
    jacobian: Array
    """G = dd/dq (P, nv) in m/rad (m/m for slides)."""
    degenerate: NDArray[np.bool_]
    """(P,) true where n is a choice or approximate, see `PairGeometry.measure`."""

    def rate_m_s(self, qvel: ArrayLike) -> Array:
        """Time derivative of the distances (P,) for joint velocities (nv,): G qvel."""
        return self.jacobian @ finite("qvel", qvel)


_TINY = np.finfo(float).tiny  # keeps a quotient by the length of a zero vector zero
_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])


def cross(a: Array, b: Array) -> Array:
    """Cross products (R, 3) row by row, in half the time of NumPy's, which looks at axes first."""
    return a.take(_NEXT, axis=1) * b.take(_LAST, axis=1) - a.take(_LAST, axis=1) * b.take(
        _NEXT, axis=1
    )


class PairGeometry:
    """What never changes about the watched pairs, resolved once from a model.

    Args:
        model: The model.
        pairs: Geom ids (i, j) of each pair: spheres, capsules, planes, boxes, cylinders,
            ellipsoids and meshes (of which MuJoCo takes the convex hull).
        sensor_adr: Address in `sensordata` (P,) of each pair's `fromto` sensor, whose geoms are i
            and j in this order, and whose cutoff exceeds every distance that can occur.

    Raises:
        InputError: A pair cannot be measured: all faults at once, naming the geoms.
    """

    def __init__(
        self, model: mujoco.MjModel, pairs: Sequence[tuple[int, int]], sensor_adr: ArrayLike
    ):
        self.geom_i, self.geom_j = np.array(pairs, dtype=int).reshape(-1, 2).T.copy()
        self.sensor_adr = np.array(sensor_adr, dtype=int).reshape(-1)
        self.body_i = model.geom_bodyid[self.geom_i]
        self.body_j = model.geom_bodyid[self.geom_j]
        self.radius_i_m, self.half_length_i_m = _core(model, self.geom_i)
        self.radius_j_m, self.half_length_j_m = _core(model, self.geom_j)
        self.face_half_size_i_m = _face_half_size(model, self.geom_i)
        self.face_half_size_j_m = _face_half_size(model, self.geom_j)
        moves = _moved_by(model)
        self.moves_i = moves[self.body_i]
        self.moves_j = moves[self.body_j]
        self.sign = self.moves_i - self.moves_j
        self.body_root = model.body_rootid.copy()
        self.body_parent = model.body_parentid.copy()
        self.dof_body = model.dof_bodyid.copy()
        self.dof_root = model.body_rootid[model.dof_bodyid]
        self.names = [
            _pair_name(model, i, j) for i, j in zip(self.geom_i, self.geom_j, strict=True)
        ]
        self._prepare()
        faults = _faults(model, self)
        if faults:
            raise InputError(faults)
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
        self._compiled: _Compiled | None = None

    def compiled(self, data: mujoco.MjData) -> _Compiled | None:
        """The compiled functions at work on this data; None where NumPy is used."""
        found = kernels()
        if found is None or not len(self):
            return None
        at_work = self._compiled
        if at_work is None or at_work.data is not data or at_work.kernels is not found:
            at_work = self._compiled = _Compiled(found, self, data)
        return at_work

    def _prepare(self) -> None:
        """Everything `measure` looks up, as flat addresses. Rows of "ends" are i, j, i, j, ..."""
        self._columns = self.sensor_adr[:, None] + np.arange(6)
        self._geoms = np.stack([self.geom_i, self.geom_j], axis=1).ravel()
        self._axis_entries = 9 * self._geoms[:, None] + np.array([2, 5, 8])
        half_length = np.stack([self.half_length_i_m, self.half_length_j_m], axis=1).reshape(-1, 1)
        self._half_length_m = half_length
        self._inverse_length_squared = np.divide(
            1.0, half_length**2, out=np.zeros_like(half_length), where=half_length > 0.0
        )[:, 0]
        self._radii_m = self.radius_i_m + self.radius_j_m
        flat_i, flat_j = self.radius_i_m == 0.0, self.radius_j_m == 0.0
        self._flat_ends = np.flatnonzero(np.stack([flat_i, flat_j], axis=1))
        self._both_round = ~(flat_i | flat_j)
        self._one_round = np.flatnonzero(flat_i ^ flat_j)
        j_is_round = flat_i[self._one_round]
        self._round_ends = 2 * self._one_round + j_is_round
        self._towards_i = np.where(j_is_round, -1.0, 1.0)[:, None]
        self._one_radius_m = self._radii_m[self._one_round]
        self._no_round = np.flatnonzero(flat_i & flat_j)

    def __len__(self) -> int:
        return len(self.geom_i)

    def half_axes(self, data: mujoco.MjData) -> Array:
        """Half-axis vectors (2P, 3) in the world, from a geom's centre to an end: i, j, i, j, ..."""
        return data.geom_xmat.take(self._axis_entries) * self._half_length_m

    def centres(self, data: mujoco.MjData) -> Array:
        """Centres of the geoms (2P, 3) in the world: i, j, i, j, ..."""
        return data.geom_xpos.take(self._geoms, axis=0)

    def measure(self, data: mujoco.MjData, *, kept: bool = False) -> Proximity:
        """Distance, direction, witness points and Jacobian of every pair.

        Two round geoms (sphere, capsule): n and d come from the axis points, so they hold through
        contact, and from the surface points where these are deep in each other, so they hold
        until the axes cross. There n is set perpendicular to both axes (`degenerate`).
        One round geom: n runs from its surface point to its axis point, so it holds at contact;
        once the axis itself enters the other geom, n is approximate and d at most -radius
        (`degenerate`, where MuJoCo's answer shows it).
        None: n is the line between the surface points; where these coincide it is the line of
        the geom centres (`degenerate`).

        Args:
            data: After `mj_kinematics`, `mj_comPos` and `mj_sensorPos`.
            kept: Whether the answer may be in arrays that the next call (or `second_order`, for another answer)
                overwrites, which saves half of the time for a hundred pairs.

        Raises:
            WorkcellError: A pair is beyond its sensor's cutoff, or a result is not finite.
        """
        compiled = self.compiled(data)
        found = None if compiled is None else compiled.measure(kept=kept)
        return self._measure(data) if found is None else found

    def _measure(self, data: mujoco.MjData) -> Proximity:
        """`measure` in NumPy; it also says what is wrong where compiled code only sees that something is."""
        fromto = data.sensordata.take(self._columns)
        if not fromto[:, 0].all():
            self._refuse_beyond(fromto)
        surface, centre, half = fromto.reshape(-1, 3), self.centres(data), self.half_axes(data)
        witness = _nearest_on_axis(surface, centre, half, self._inverse_length_squared)
        witness[self._flat_ends] = surface[self._flat_ends]
        surface_i, surface_j = surface[0::2], surface[1::2]
        witness_i, witness_j = witness[0::2], witness[1::2]

        along = witness_i - witness_j
        length = _norm(along)
        distance = length - self._radii_m
        degenerate = np.zeros(len(self), dtype=bool)
        # Round pairs this near are rare; where there are none, the test is all that is done.
        if len(self) and distance.min() < CROSSING_TOLERANCE_M:
            degenerate |= self._set_deep(
                half, surface_i, surface_j, witness_i, witness_j, along, distance
            )
            length = _norm(along)
        if self._one_round.size:
            self._set_one_round(surface, witness, along, distance, length, degenerate)
        if self._no_round.size:
            self._set_no_round(centre, surface, along, distance, degenerate)
            length = _norm(along)
        if not length.all():
            undirected = length == 0.0
            along[undirected], length[undirected] = (1.0, 0.0, 0.0), 1.0
            degenerate |= undirected
        if not all_finite(distance):
            name = self.names[int(np.argmin(np.isfinite(distance)))]
            raise WorkcellError(f"the distance of {name} is not finite; check qpos")
        normal = along / length[:, None]
        return Proximity(
            distance_m=distance,
            normal=normal,
            witness_i_m=witness_i,
            witness_j_m=witness_j,
            surface_i_m=surface_i,
            surface_j_m=surface_j,
            jacobian=self._jacobian(data, normal, witness_i),
            degenerate=degenerate,
        )

    def _refuse_beyond(self, fromto: Array) -> None:
        """A sensor that reads nothing but zero has not seen its pair."""
        beyond = ~fromto.any(axis=1)
        if beyond.any():
            name = self.names[int(np.argmax(beyond))]
            raise WorkcellError(
                f"fromto sensor of {name} reads zero: the sensors were not computed, or the pair "
                f"is beyond the sensor's cutoff; raise the cutoff above the size of the cell"
            )

    def _set_deep(
        self,
        half: Array,
        surface_i: Array,
        surface_j: Array,
        witness_i: Array,
        witness_j: Array,
        along: Array,
        distance: Array,
    ) -> NDArray[np.bool_]:
        """Round pairs deep in each other: n from the surface points, which are then far apart.

        The axis points are too near each other to give a direction as well. Where they meet, n is
        set perpendicular to both axes, as MuJoCo's direction may not be; these are returned.
        Pairs that are separate by such a gap have axes farther apart than both radii.
        """
        radii = self._radii_m
        gap = surface_i - surface_j
        gap_length = np.linalg.norm(gap, axis=1)
        rows = self._both_round & (2.0 * gap_length > radii) & (distance < CROSSING_TOLERANCE_M)
        crossing = np.zeros(len(self), dtype=bool)
        if rows.any():
            inwards = -gap[rows] / gap_length[rows, None]
            along[rows] = inwards
            distance[rows] = -gap_length[rows]
            witness_i[rows] = surface_i[rows] + self.radius_i_m[rows, None] * inwards
            witness_j[rows] = surface_j[rows] - self.radius_j_m[rows, None] * inwards
            crossing = rows & (gap_length > radii - CROSSING_TOLERANCE_M)
            along[crossing] = _perpendicular(half[0::2][crossing], half[1::2][crossing])
        return crossing

    def _set_one_round(
        self,
        surface: Array,
        witness: Array,
        along: Array,
        distance: Array,
        length: Array,
        degenerate: NDArray[np.bool_],
    ) -> None:
        """One round geom: n from its surface point to its axis point, d along n.

        Once the axis itself is inside the other geom, MuJoCo's capsule against box may report any
        depth, and even 1 mm of clearance; but then its surface point is not on the surface. The
        depth is at least the radius there, and is said to be no less.
        """
        rows, ends = self._one_round, self._round_ends
        to_axis = self._towards_i * (witness.take(ends, axis=0) - surface.take(ends, axis=0))
        to_axis_m, radius = _norm(to_axis), self._one_radius_m
        gap = surface.take(2 * rows, axis=0) - surface.take(2 * rows + 1, axis=0)
        measured = np.vecdot(to_axis, gap) / np.maximum(to_axis_m, _TINY)
        depth_unknown = np.abs(to_axis_m - radius) > SURFACE_TOLERANCE_M
        if depth_unknown.any():
            measured = np.where(depth_unknown, np.minimum(measured, -radius), measured)
            degenerate[rows] = depth_unknown
        distance[rows], along[rows], length[rows] = measured, to_axis, to_axis_m

    def _set_no_round(
        self,
        centre: Array,
        surface: Array,
        along: Array,
        distance: Array,
        degenerate: NDArray[np.bool_],
    ) -> None:
        """No round geom: n along the line of the surface points, or of the centres at contact.

        All of a convex geom lies on the far side of its witness point, so the centres tell
        whether that line leads out (separate) or in (penetrating).
        """
        rows = self._no_round
        gap = surface[2 * rows] - surface[2 * rows + 1]
        centres = centre[2 * rows] - centre[2 * rows + 1]
        gap_m = _norm(gap)
        sign = np.where(np.vecdot(gap, centres - gap) < 0.0, -1.0, 1.0)
        touching = gap_m < COINCIDENT_TOLERANCE_M
        along[rows] = np.where(touching[:, None], centres, sign[:, None] * gap)
        distance[rows], degenerate[rows] = sign * gap_m, touching

    def _jacobian(self, data: mujoco.MjData, normal: Array, point: Array) -> Array:
        """G = sign (n (nu + c x omega) + (w x n) omega): the line of n times the joint screws.

        Both witness points lie on that line, so one product serves the joints of i and of j.
        """
        line = np.empty((len(self), 6))
        line[:, :3], line[:, 3:] = cross(point, normal), normal
        screws = data.cdof.copy()
        screws[:, 3:] += cross(data.subtree_com[self.dof_root], screws[:, :3])
        return self.sign * (line @ screws.T)


class _Compiled:
    """The compiled functions for one geometry, bound to the arrays of one data.

    Args:
        kernels: Of this process.
        geometry: The pairs.
        data: Its arrays never move, so their addresses are taken once.
    """

    def __init__(self, kernels: Kernels, geometry: PairGeometry, data: mujoco.MjData):
        self.kernels = kernels
        self.data = data
        joints, bodies = len(geometry.dof_root), len(geometry.body_root)
        sizes = {
            "pairs": len(geometry),
            "joints": joints,
            "bodies": bodies,
            "geoms": len(data.geom_xpos),
            "sensors": len(data.sensordata),
        }
        common = {
            "geom_xpos": data.geom_xpos,
            "geom_xmat": data.geom_xmat,
            "cdof": data.cdof,
            "subtree_com": data.subtree_com,
            "geom": _integers(np.stack([geometry.geom_i, geometry.geom_j], axis=1)),
            "radius": np.stack([geometry.radius_i_m, geometry.radius_j_m], axis=1),
            "half_length": np.stack([geometry.half_length_i_m, geometry.half_length_j_m], axis=1),
        }
        self._measure: Bound = kernels.bind(
            "measure",
            sizes,
            **common,
            sensordata=data.sensordata,
            sensor_adr=_integers(geometry.sensor_adr),
            dof_root=_integers(geometry.dof_root),
            sign=geometry.sign,
        )
        self.second_order: Bound = kernels.bind(
            "second_order",
            sizes,
            **common,
            cdof_dot=data.cdof_dot,
            qvel=data.qvel,
            body_parent=_integers(geometry.body_parent),
            body_root=_integers(geometry.body_root),
            dof_body=_integers(geometry.dof_body),
            body=_integers(np.stack([geometry.body_i, geometry.body_j], axis=1)),
            face=np.stack([geometry.face_half_size_i_m, geometry.face_half_size_j_m], axis=1),
            **{
                name: self._measure.arrays[name]
                for name in ("witness_i", "witness_j", "normal", "degenerate")
            },
        )
        kept = self._measure.arrays
        self._found = Proximity(
            **{field.name: kept[field.name.removesuffix("_m")] for field in fields(Proximity)}
        )

    def measure(self, *, kept: bool) -> Proximity | None:
        """What `PairGeometry.measure` returns; None where NumPy has to say what is wrong."""
        self._measure.run()
        if self._measure.done() != DONE:
            return None
        if kept:
            return self._found
        return Proximity(**{name: array.copy() for name, array in vars(self._found).items()})


def _integers(values: NDArray[Any]) -> NDArray[np.int64]:
    return np.ascontiguousarray(values, dtype=np.int64)


def _core(model: mujoco.MjModel, geom: NDArray[np.int_]) -> tuple[Array, Array]:
    """Radius and half length of a geom's axis: (0, 0) for a geom that is not round."""
    kind = model.geom_type[geom]
    radius = np.where(np.isin(kind, _ROUND), model.geom_size[geom, 0], 0.0)
    half_length = np.where(kind == _GEOM.mjGEOM_CAPSULE, model.geom_size[geom, 1], 0.0)
    return radius, half_length


def _face_half_size(model: mujoco.MjModel, geom: NDArray[np.int_]) -> Array:
    """Half sizes (P, 3) of the geoms with flat faces: a box's, infinite for a plane, else zero."""
    kind = model.geom_type[geom][:, None]
    solid = np.where(kind == _GEOM.mjGEOM_BOX, model.geom_size[geom], 0.0)
    return np.where(kind == _GEOM.mjGEOM_PLANE, np.inf, solid)


def _moved_by(model: mujoco.MjModel) -> Array:
    """1 where a dof (column) moves a body (row), itself or through a parent: (nbody, nv)."""
    moves = np.zeros((model.nbody, model.nv))
    moves[model.dof_bodyid, np.arange(model.nv)] = 1.0
    for body in range(1, model.nbody):  # Parents come before their children.
        moves[body] += moves[model.body_parentid[body]]
    return moves


def _faults(model: mujoco.MjModel, pairs: PairGeometry) -> list[str]:
    faults = []
    if len(pairs.sensor_adr) != len(pairs):
        return [f"sensor_adr has {len(pairs.sensor_adr)} entries; must be one for each pair"]
    sensor_at = {int(adr): k for k, adr in enumerate(model.sensor_adr)}
    for k, (i, j) in enumerate(zip(pairs.geom_i, pairs.geom_j, strict=True)):
        name = pairs.names[k]
        kinds = {int(model.geom_type[i]), int(model.geom_type[j])}
        if not kinds <= {*_ROUND, *_FLAT}:
            faults.append(f"{name}: heightfields and signed distance fields are not supported")
        if not pairs.sign[k].any():
            faults.append(f"{name}: no joint moves one geom without the other")
        sensor = sensor_at.get(int(pairs.sensor_adr[k]))
        if sensor is None or not _reads(model, sensor, int(i), int(j)):
            faults.append(
                f"{name}: sensor_adr {pairs.sensor_adr[k]} is not the address of a fromto sensor "
                f"from the first to the second geom"
            )
        elif not model.sensor_cutoff[sensor] > 0.0:
            faults.append(f"{name}: its fromto sensor has cutoff 0 and would see contacts only")
    return faults


def _reads(model: mujoco.MjModel, sensor: int, i: int, j: int) -> bool:
    return (
        model.sensor_type[sensor] == mujoco.mjtSensor.mjSENS_GEOMFROMTO
        and model.sensor_objtype[sensor] == mujoco.mjtObj.mjOBJ_GEOM
        and model.sensor_reftype[sensor] == mujoco.mjtObj.mjOBJ_GEOM
        and (model.sensor_objid[sensor], model.sensor_refid[sensor]) == (i, j)
    )


def _pair_name(model: mujoco.MjModel, i: int, j: int) -> str:
    first, second = (model.geom(int(g)).name or f"geom {g}" for g in (i, j))
    return f"pair {first} - {second}"


def _norm(vectors: Array) -> Array:
    """Lengths (R,) of rows."""
    return np.sqrt(np.vecdot(vectors, vectors))


def _nearest_on_axis(
    point: Array, centre: Array, half: Array, inverse_length_squared: Array
) -> Array:
    """The point of each axis (centre +- half) nearest to a point; the centre of a sphere's.

    One over the axis's squared half length comes along, being fixed; 0 for a sphere.
    """
    along = np.vecdot(point - centre, half) * inverse_length_squared
    np.maximum(along, -1.0, out=along)
    np.minimum(along, 1.0, out=along)
    return centre + along[:, None] * half


def _perpendicular(u: Array, v: Array) -> Array:
    """A vector perpendicular to u and v; to the longer one where they are parallel; else zero."""
    crossed = np.cross(u, v)
    longer = np.where((np.vecdot(u, u) >= np.vecdot(v, v))[:, None], u, v)
    least = np.eye(3)[np.argmin(np.abs(longer), axis=1)]
    any_side = np.cross(longer, least)
    scale = np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1)
    skew = np.linalg.norm(crossed, axis=1) > CROSSING_PARALLEL_SINE * scale
    return np.where(skew[:, None], crossed, any_side)
