"""Distances of watched geom pairs and their Jacobian (docs/theory.md sections 1, 2).

In: a MuJoCo model, whose `fromto` sensors hold the witness points of each pair or which is asked for them pair by
pair, and data on which kinematics (and sensors) were computed. Out: signed distance d, direction n, witness points, the
Jacobian G = dd/dq of every pair (paper equations 3 to 5). The arithmetic is `laws.distance`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from workcell.control.finite import finite
from workcell.control.laws import distance as laws
from workcell.errors import InputError, WorkcellError
from workcell.scene.pairs import SENSOR_CUTOFF_M

Array = NDArray[np.float64]

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


class PairGeometry:
    """What never changes about the watched pairs, resolved once from a model.

    Args:
        model: The model.
        pairs: Geom ids (i, j) of each pair: spheres, capsules, planes, boxes, cylinders,
            ellipsoids and meshes (of which MuJoCo takes the convex hull).
        sensor_adr: Address in `sensordata` (P,) of each pair's `fromto` sensor, whose geoms are i
            and j in this order, and whose cutoff exceeds every distance that can occur. None for a model
            without such sensors: every measurement then searches for the witness points itself, with
            the same result.

    Raises:
        InputError: A pair cannot be measured: all faults at once, naming the geoms.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        pairs: Sequence[tuple[int, int]],
        sensor_adr: ArrayLike | None = None,
    ):
        self.geom = np.array(pairs, dtype=np.int64).reshape(-1, 2)
        self._searched_m: Array | None = None
        if sensor_adr is None:
            self._searched_m = np.zeros((len(self.geom), 6))
            sensor_adr = 6 * np.arange(len(self.geom))
        self.sensor_adr = np.array(sensor_adr, dtype=np.int64).reshape(-1)
        self.body = model.geom_bodyid[self.geom].astype(np.int64)
        self.radius_m, self.half_length_m = _core(model, self.geom)
        self.face_half_size_m = _face_half_size(model, self.geom)
        moves = _moved_by(model)
        self.sign = moves[self.body[:, 0]] - moves[self.body[:, 1]]
        self.body_root = model.body_rootid.astype(np.int64)
        self.body_parent = model.body_parentid.astype(np.int64)
        self.dof_body = model.dof_bodyid.astype(np.int64)
        self.dof_root = self.body_root[model.dof_bodyid]
        self.names = [_pair_name(model, int(i), int(j)) for i, j in self.geom]
        faults = _faults(model, self)
        if faults:
            raise InputError(faults)
        for value in vars(self).values():
            if isinstance(value, np.ndarray) and value is not self._searched_m:
                value.setflags(write=False)
        self.model = model
        self._state: PairState | None = None

    @property
    def has_sensors(self) -> bool:
        """Whether the witness points come from sensors of the model."""
        return self._searched_m is None

    def witness_points(self, data: mujoco.MjData) -> Array:
        """The array from which the laws read six numbers for each pair, at `sensor_adr`."""
        return data.sensordata if self._searched_m is None else self._searched_m.reshape(-1)

    def state(self, data: mujoco.MjData) -> PairState:
        """The arrays that the laws read and write for this data, kept from call to call."""
        if self._state is None or self._state.data is not data:
            self._state = PairState(self, data)
        return self._state

    def __len__(self) -> int:
        return len(self.geom)

    def measure(self, data: mujoco.MjData, *, kept: bool = False) -> Proximity:
        """Distance, direction, witness points and Jacobian of every pair; see `laws.distance.measure`.

        Args:
            data: After `mj_kinematics` and `mj_comPos`, and `mj_sensorPos` where there are sensors.
            kept: Whether the answer may be in arrays that the next call (or `second_order`, for another answer)
                overwrites, which saves half of the time for a hundred pairs.

        Raises:
            WorkcellError: A pair is beyond its sensor's cutoff, or a result is not finite.
        """
        state = self.state(data)
        if self._searched_m is not None:
            for (i, j), points in zip(self.geom.tolist(), self._searched_m, strict=True):
                mujoco.mj_geomDistance(self.model, data, i, j, SENSOR_CUTOFF_M, points)
        code, pair = laws.measure(*state.measured)
        if code == laws.BEYOND_CUTOFF:
            raise WorkcellError(
                f"fromto sensor of {self.names[pair]} reads zero: the sensors were not computed, or the pair "
                f"is beyond the sensor's cutoff; raise the cutoff above the size of the cell"
            )
        if code == laws.NOT_FINITE:
            raise WorkcellError(f"the distance of {self.names[pair]} is not finite; check qpos")
        if kept:
            return state.found
        return Proximity(**{name: array.copy() for name, array in vars(state.found).items()})


class PairState:
    """What the laws read and write for one geometry on one data.

    Args:
        geometry: The pairs.
        data: Its arrays never move, so they are asked for once.
    """

    def __init__(self, geometry: PairGeometry, data: mujoco.MjData):
        self.data = data
        pairs, joints = geometry.sign.shape
        normal, witness_i, witness_j, surface_i, surface_j = np.zeros((5, pairs, 3))
        self.found = Proximity(
            np.zeros(pairs), normal, witness_i, witness_j, surface_i, surface_j, np.zeros((pairs, joints)),
            np.zeros(pairs, dtype=bool),
        )  # fmt: skip
        """The last answer of `laws.distance.measure`."""
        found = self.found
        self.measured: tuple[Any, ...] = (
            geometry.witness_points(data), data.geom_xpos, data.geom_xmat, data.cdof, data.subtree_com,
            geometry.sensor_adr, geometry.geom, geometry.radius_m, geometry.half_length_m,
            geometry.sign, geometry.dof_root, np.zeros((6, joints)), found.distance_m, found.normal,
            found.witness_i_m, found.witness_j_m, found.surface_i_m, found.surface_j_m,
            found.jacobian, found.degenerate,
        )  # fmt: skip
        """Its arguments."""
        bodies = len(geometry.body_root)
        self.qacc = np.zeros(joints)
        self.accel_m_s2 = np.zeros(pairs)
        self.exact, self.parallel = np.zeros(pairs, dtype=bool), np.zeros(pairs, dtype=bool)
        self.moving: tuple[Any, ...] = (
            data.geom_xpos, data.geom_xmat, data.cdof, data.cdof_dot, data.subtree_com, data.qvel,
            self.qacc, geometry.body_parent, geometry.body_root, geometry.dof_body, geometry.geom,
            geometry.body, geometry.radius_m, geometry.half_length_m, geometry.face_half_size_m,
            found.witness_i_m, found.witness_j_m, found.normal, found.degenerate,
            np.zeros((bodies, 6)), np.zeros((bodies, 6)), self.accel_m_s2, self.exact, self.parallel,
        )  # fmt: skip
        """The arguments of `laws.second_derivative.second_derivative`."""


def _core(model: mujoco.MjModel, geom: NDArray[np.int_]) -> tuple[Array, Array]:
    """Radii and half lengths (P, 2) of the geoms' axes: 0 for a geom that is not round."""
    kind = model.geom_type[geom]
    radius = np.where(np.isin(kind, _ROUND), model.geom_size[geom, 0], 0.0)
    half_length = np.where(kind == _GEOM.mjGEOM_CAPSULE, model.geom_size[geom, 1], 0.0)
    return radius, half_length


def _face_half_size(model: mujoco.MjModel, geom: NDArray[np.int_]) -> Array:
    """Half sizes (P, 2, 3) of the geoms with flat faces: a box's, infinite for a plane, else zero."""
    kind = model.geom_type[geom][..., None]
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
    for k, (i, j) in enumerate(pairs.geom):
        name = pairs.names[k]
        kinds = {int(model.geom_type[i]), int(model.geom_type[j])}
        if not kinds <= {*_ROUND, *_FLAT}:
            faults.append(f"{name}: heightfields and signed distance fields are not supported")
        if not pairs.sign[k].any():
            faults.append(f"{name}: no joint moves one geom without the other")
        if not pairs.has_sensors:
            continue
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
    first, second = (model.geom(g).name or f"geom {g}" for g in (i, j))
    return f"pair {first} - {second}"
