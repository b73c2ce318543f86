"""Cells for the gate's tests: arms as MuJoCo models, their pairs, and what a stop really does to them."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.control.gate import GateGeometry, GateRules, JointLimits, JointState
from workcell.control.proximity import PairGeometry

Array = NDArray[np.float64]


@dataclass
class Bench:
    """One arm (the gated one) of a model, with the pairs it is a party to."""

    model: mujoco.MjModel
    data: mujoco.MjData
    dofs: NDArray[np.intp]
    limits: JointLimits
    proximity: PairGeometry
    gate: GateGeometry

    def place(self, qpos: Array) -> None:
        """Bring the data to a configuration as far as rows need it."""
        self.data.qpos[:] = qpos
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_sensorPos(self.model, self.data)

    def rows(self):
        """At the present configuration."""
        return self.gate.rows(self.data, self.proximity.measure(self.data))

    def geoms(self) -> list[tuple[int, int]]:
        """Geom ids of the gated pairs."""
        pair = self.gate.pair
        return [(int(i), int(j)) for i, j in self.proximity.geom[pair]]

    def distances(self) -> Array:
        """Of the gated pairs, by MuJoCo's own search."""
        return np.array(
            [
                mujoco.mj_geomDistance(self.model, self.data, i, j, 50.0, None)
                for i, j in self.geoms()
            ]
        )

    def state(self, last: Array, change: Array | None = None) -> JointState:
        """The measured state after a command."""
        nothing = np.zeros(len(self.dofs))
        return JointState(
            self.data.qpos[self.dofs].copy(),
            last,
            nothing if change is None else change,
            nothing,
            nothing,
        )


def bench(
    bodies: str,
    own: str,
    *,
    acceleration: float | Array = 2.0,
    speed: float | Array = 1.5,
    reach: float = np.inf,
    jerk: float = np.inf,
    neighbours: int = 2,
    assets: str = "",
) -> Bench:
    """A model of `bodies`; the gated arm's geoms are named `own/...`, one hinge or slide a body.

    Watched is every geom of the arm against everything else, and against its own geoms more than
    `neighbours` joints away.
    """
    text = (
        "<mujoco><compiler angle='radian'/><default><geom contype='0' conaffinity='0' mass='1'/></default>"
        f"<asset>{assets}</asset><worldbody>{bodies}</worldbody>{{}}</mujoco>"
    )
    bare = mujoco.MjModel.from_xml_string(text.format(""))
    mine = [g for g in range(bare.ngeom) if bare.geom(g).name.startswith(f"{own}/")]
    joints_of = {g: _above(bare, g) for g in range(bare.ngeom)}
    dofs = np.array(sorted(set().union(*(joints_of[g] for g in mine))), dtype=np.intp)
    pairs = [
        (g, h)
        for k, g in enumerate(mine)
        for h in [*mine[k + 1 :], *(h for h in range(bare.ngeom) if h not in mine)]
        if len(joints_of[g] ^ joints_of[h] if h in mine else joints_of[g])
        > (neighbours if h in mine else 0)
    ]
    sensors = "".join(
        f'<fromto geom1="{bare.geom(g).name}" geom2="{bare.geom(h).name}" cutoff="50"/>'
        for g, h in pairs
    )
    model = mujoco.MjModel.from_xml_string(text.format(f"<sensor>{sensors}</sensor>"))
    n = len(dofs)
    limits = JointLimits(
        np.full(n, -reach),
        np.full(n, reach),
        np.broadcast_to(np.asarray(speed, float), n).copy(),
        np.broadcast_to(np.asarray(acceleration, float), n).copy(),
        np.full(n, jerk),
    )
    return Bench(
        model,
        mujoco.MjData(model),
        dofs,
        limits,
        PairGeometry(model, pairs, model.sensor_adr),
        GateGeometry(model, dofs, np.array(pairs), range(len(pairs))),
    )


def _above(model: mujoco.MjModel, geom: int) -> set[int]:
    body, found = int(model.geom_bodyid[geom]), set()
    while body:
        found.update(
            range(model.body_dofadr[body], model.body_dofadr[body] + model.body_dofnum[body])
        )
        body = int(model.body_parentid[body])
    return found


def stop_states(
    q: Array, x: Array, deceleration: Array, reaction_s: float, dt: float
) -> list[Array]:
    """Configurations along a ticked stop: the command acts for the reaction time, then each joint brakes."""
    states, v = [], x.copy()
    q = q + x * reaction_s
    states.append(q.copy())
    while np.abs(v).max() > 0.0:
        v = np.sign(v) * np.maximum(np.abs(v) - deceleration * dt, 0.0)
        q = q + v * dt
        states.append(q.copy())
    return states


def serial_arm(
    name: str, at: str, lengths, radii, axes, *, kind: str = "capsule", joint: str = "hinge"
) -> str:
    """A chain of capsules (or boxes) with one joint each."""
    opening = closing = ""
    for k, (length, radius, axis) in enumerate(zip(lengths, radii, axes, strict=True)):
        shape = (
            f'type="capsule" size="{radius}" fromto="0.01 0 0 0 0.02 {length}"'
            if kind == "capsule"
            else f'type="box" size="{radius} {0.7 * radius} {length / 2}" pos="0 0 {length / 2}"'
        )
        opening += (
            f'<body pos="{at}"><joint name="{name}{k}" type="{joint}" axis="{axis}"/>'
            f'<geom name="{name}/c{k}" {shape}/>'
        )
        closing += "</body>"
        at = f"0 0 {length}"
    return opening + closing


PA10_AXES = ("0 0 1", "0 1 0", "0 0 1", "0 1 0", "0 0 1", "0 1 0", "0 0 1")
PA10_LENGTHS = (0.2, 0.25, 0.2, 0.3, 0.2, 0.1, 0.08)
PA10_RADII = (0.09, 0.08, 0.08, 0.07, 0.06, 0.06, 0.03)
PA10_SPEED = np.array([1.0, 1.0, 2.0, 2.0, 6.28, 6.28, 6.28])
PA10_ACCELERATION = np.array([2.0, 2.0, 4.0, 4.0, 6.0, 6.0, 6.0])


def seven_joint_arm(name: str, at: str, **options) -> str:
    """An arm of the PA10's proportions."""
    return serial_arm(name, at, PA10_LENGTHS, PA10_RADII, PA10_AXES, **options)


def planar_arm(name: str, at: str, joints: int = 3) -> str:
    """A flat arm: all axes parallel, all capsules in one plane."""
    return serial_arm(name, at, (0.4,) * joints, (0.04,) * joints, ("0 1 0",) * joints)


def rules(**options) -> GateRules:
    """At 10 ms and t_min 1 s unless told otherwise."""
    return GateRules(**({"period_s": 0.01, "t_min_s": 1.0} | options))
