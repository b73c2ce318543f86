"""An arm file -> its normal form: the same arm in plain MJCF, ready to be attached to a cell.

In: an arm file compiled alone (arm_file.py), the joints that are driven, and where the others stand.
Out: an MJCF text in radians, with quaternions, explicit inertias and explicit limits, without
defaults, options or anything else that another file beside it could change. All numbers are those
of the compiled model, with 17 digits. A joint that is not driven is left out: its body is fixed where
the joint's value puts it, with its mass and geometry.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from lxml import etree
from numpy.typing import NDArray

from workcell.errors import InputError
from workcell.scene.arm_file import (
    ACCELERATION_LIMIT_NUMERIC,
    VELOCITY_LIMIT_NUMERIC,
    ArmFile,
    plain,
)

_GEOM = mujoco.mjtGeom
SIZES = {
    int(_GEOM.mjGEOM_SPHERE): ("sphere", 1),
    int(_GEOM.mjGEOM_CAPSULE): ("capsule", 2),
    int(_GEOM.mjGEOM_ELLIPSOID): ("ellipsoid", 3),
    int(_GEOM.mjGEOM_CYLINDER): ("cylinder", 2),
    int(_GEOM.mjGEOM_BOX): ("box", 3),
    int(_GEOM.mjGEOM_MESH): ("mesh", 0),
}
"""Types of geoms that a cell carries, and how many numbers their size has."""
_NO_COLOUR = (0.5, 0.5, 0.5, 1.0)
"""MuJoCo's colour of a geom that names none: its material's counts then."""


@dataclass(frozen=True, eq=False)
class NormalForm:
    """An arm, ready to be attached."""

    xml: str
    assets: dict[str, bytes]
    """Meshes, by the file names the text uses."""
    driven: tuple[int, ...]
    """Numbers of the joints it has, among those of the file."""
    bodies: dict[int, str]
    """Names of its bodies by their numbers in the file; without the file's world."""
    left_out: tuple[str, ...]
    """What was left out, beside what belongs to the cell: a sentence each."""


def normal_form(file: ArmFile, home: NDArray[np.float64], driven: Sequence[int]) -> NormalForm:
    """Write the arm with only its driven joints.

    Args:
        file: The arm file, compiled alone.
        home: (nq,) configuration of all of its joints; what is not driven stays there.
        driven: Numbers of the joints that are driven.

    Raises:
        InputError: something ties driven joints together (equality, tendon), or an actuator has a
            part that a cell does not carry.
    """
    writer = _Writer(file, home, tuple(driven))
    faults = list(writer.ties())
    if faults:
        raise InputError(faults)
    return writer.write()


class _Writer:
    """The state of one writing: a compiled model at home and the tree that is filled from it."""

    def __init__(self, file: ArmFile, home: NDArray[np.float64], driven: tuple[int, ...]) -> None:
        self.file, self.model, self.driven = file, file.model, driven
        self._home = home
        self._rigid = rigid_links(self.model, driven)
        self._left_out: list[str] = []
        self._meshes: set[int] = set()
        self._materials: set[int] = set()

    def write(self) -> NormalForm:
        """The whole text."""
        root = etree.Element("mujoco", model="arm")
        etree.SubElement(root, "compiler", angle="radian", autolimits="true")
        asset = etree.SubElement(root, "asset")
        world = etree.SubElement(root, "worldbody")
        self._fill(world, 0)
        elements = {0: world}
        bodies = {}
        for body in range(1, self.model.nbody):
            elements[body] = self._body(elements[int(self.model.body_parentid[body])], body)
            bodies[body] = self.file.bodies[body]
        assets = {}
        for material in sorted(self._materials):
            asset.append(self._material(material))
        for mesh in sorted(self._meshes):
            new = etree.SubElement(asset, "mesh", name=self.file.meshes[mesh])
            if _is_its_own_hull(self.model, mesh):
                # Of vertices alone MuJoCo makes the hull, by which it measures distances faster.
                _set(new, vertex=_shortest(_vertices(self.model, mesh).reshape(-1)))
            else:
                # The frame of a shell's inertia exists for open and flat surfaces too.
                new.set("inertia", "shell")
                new.set("file", f"mesh{mesh}.msh")
                assets[f"mesh{mesh}.msh"] = _surface(self.model, mesh)
        self._excludes(root)
        self._actuators(root)
        self._numerics(root)
        if not len(asset):
            root.remove(asset)
        return NormalForm(
            xml=etree.tostring(root, pretty_print=True, encoding="unicode"),
            assets=assets,
            driven=self.driven,
            bodies=bodies,
            left_out=tuple(self._left_out),
        )

    def _body(self, parent: etree._Element, body: int) -> etree._Element:
        model = self.model
        element = etree.SubElement(parent, "body", name=self.file.bodies[body])
        joints = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
        if all(joint in self.driven for joint in joints):
            position, wxyz = model.body_pos[body], model.body_quat[body]
        else:
            position, wxyz = self._pose_without(body, joints)
        _set(element, pos=position, quat=wxyz)
        if model.body_gravcomp[body]:
            _set(element, gravcomp=[model.body_gravcomp[body]])
        if model.body_mass[body] > 0:
            inertial = etree.SubElement(element, "inertial")
            _set(
                inertial,
                pos=model.body_ipos[body],
                quat=model.body_iquat[body],
                mass=[model.body_mass[body]],
                diaginertia=model.body_inertia[body],
            )
        for joint in joints:
            if joint in self.driven:
                self._joint(element, joint)
        self._fill(element, body)
        return element

    def _pose_without(
        self, body: int, joints: range
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Where a body stands in its parent when its own undriven joints have their values and the driven ones none."""
        model = self.model
        alone = mujoco.MjData(model)
        alone.qpos[:] = self._home
        for joint in joints:
            if joint in self.driven:
                address = model.jnt_qposadr[joint]
                alone.qpos[address] = model.qpos0[address]
        mujoco.mj_kinematics(model, alone)
        parent = int(model.body_parentid[body])
        inverse, wxyz, position = np.zeros(4), np.zeros(4), np.zeros(3)
        mujoco.mju_negQuat(inverse, alone.xquat[parent])
        mujoco.mju_mulQuat(wxyz, inverse, alone.xquat[body])
        mujoco.mju_rotVecQuat(position, alone.xpos[body] - alone.xpos[parent], inverse)
        return position, wxyz

    def _joint(self, element: etree._Element, joint: int) -> None:
        model = self.model
        address, dof = model.jnt_qposadr[joint], model.jnt_dofadr[joint]
        new = etree.SubElement(
            element,
            "joint",
            name=self.file.joints[joint],
            type=self.file.kinds[joint],
            limited=_truth(model.jnt_limited[joint]),
            actuatorfrclimited=_truth(model.jnt_actfrclimited[joint]),
            actuatorgravcomp=_truth(model.jnt_actgravcomp[joint]),
        )
        _set(new, pos=model.jnt_pos[joint], axis=model.jnt_axis[joint])
        _set_unless_zero(new, range=model.jnt_range[joint])
        _set_unless_zero(new, actuatorfrcrange=model.jnt_actfrcrange[joint])
        _set_unless_zero(
            new,
            ref=[model.qpos0[address]],
            springref=[model.qpos_spring[address]],
            stiffness=[model.jnt_stiffness[joint]],
            damping=[model.dof_damping[dof]],
            armature=[model.dof_armature[dof]],
            frictionloss=[model.dof_frictionloss[dof]],
            margin=[model.jnt_margin[joint]],
        )
        _set(
            new,
            solreflimit=model.jnt_solref[joint],
            solimplimit=model.jnt_solimp[joint],
            solreffriction=model.dof_solref[dof],
            solimpfriction=model.dof_solimp[dof],
        )

    def _fill(self, element: etree._Element, body: int) -> None:
        """Geoms and sites of a body."""
        model = self.model
        for geom in range(
            model.body_geomadr[body], model.body_geomadr[body] + model.body_geomnum[body]
        ):
            self._geom(element, geom)
        for site in np.flatnonzero(model.site_bodyid == body):
            self._site(element, int(site))

    def _geom(self, element: etree._Element, geom: int) -> None:
        model = self.model
        if model.geom_type[geom] == _GEOM.mjGEOM_PLANE:
            return
        kind, sizes = SIZES[int(model.geom_type[geom])]
        # A collision here is a verdict of the checks, not a bounce: contacts would only blur it.
        new = etree.SubElement(
            element,
            "geom",
            name=self.file.geoms[geom],
            type=kind,
            contype="0",
            conaffinity="0",
            mass="0",
            group=str(int(model.geom_group[geom])),
        )
        if sizes:
            _set(new, size=model.geom_size[geom, :sizes])
        else:
            mesh = int(model.geom_dataid[geom])
            self._meshes.add(mesh)
            new.set("mesh", self.file.meshes[mesh])
        _set(new, pos=model.geom_pos[geom], quat=model.geom_quat[geom])
        self._look(new, model.geom_matid[geom], model.geom_rgba[geom])

    def _site(self, element: etree._Element, site: int) -> None:
        model = self.model
        kind, sizes = SIZES.get(int(model.site_type[site]), ("sphere", 1))
        new = etree.SubElement(
            element,
            "site",
            name=self.file.sites[site],
            type=kind if sizes else "sphere",
            group=str(int(model.site_group[site])),
        )
        _set(new, size=model.site_size[site, : sizes or 1])
        _set(new, pos=model.site_pos[site], quat=model.site_quat[site])
        self._look(new, model.site_matid[site], model.site_rgba[site])

    def _look(self, element: etree._Element, material: int, rgba: NDArray[np.float32]) -> None:
        if material >= 0:
            self._materials.add(int(material))
            element.set("material", self.file.materials[material])
        if material < 0 or not np.allclose(rgba, _NO_COLOUR):
            _set(element, rgba=_shortest(rgba))

    def _material(self, material: int) -> etree._Element:
        model = self.model
        element = etree.Element("material", name=self.file.materials[material])
        _set(element, rgba=_shortest(model.mat_rgba[material]))
        for key in ("emission", "specular", "shininess", "reflectance"):
            _set(element, **{key: _shortest(getattr(model, f"mat_{key}")[[material]])})
        return element

    def _excludes(self, root: etree._Element) -> None:
        """Pairs of bodies that the file takes out of its collisions by name."""
        contact = etree.SubElement(root, "contact")
        for signature in self.model.exclude_signature:
            pair = int(signature) >> 16, int(signature) & 0xFFFF
            if 0 not in pair:
                bodies = {f"body{k + 1}": self.file.bodies[body] for k, body in enumerate(pair)}
                etree.SubElement(contact, "exclude", **bodies)
        if not len(contact):
            root.remove(contact)

    def _actuators(self, root: etree._Element) -> None:
        model = self.model
        actuators = etree.SubElement(root, "actuator")
        dropped = []
        for k in range(model.nactuator):
            name = self.file.actuators[k]
            joint = int(model.actuator_trnid[k, 0])
            if model.actuator_trntype[k] != mujoco.mjtTrn.mjTRN_JOINT or joint not in self.driven:
                dropped.append(name)
                continue
            actuators.append(self._actuator(k, joint))
        if dropped:
            self._left_out.append(f"actuators {_some(dropped)}: they move no driven joint")
        if not len(actuators):
            root.remove(actuators)

    def _actuator(self, k: int, joint: int) -> etree._Element:
        model = self.model
        element = etree.Element(
            "general",
            name=self.file.actuators[k],
            joint=self.file.joints[joint],
            group=str(int(model.actuator_group[k])),
            gaintype=_kind(mujoco.mjtGain, model.actuator_gaintype[k]),
            biastype=_kind(mujoco.mjtBias, model.actuator_biastype[k]),
            dyntype=_kind(mujoco.mjtDyn, model.actuator_dyntype[k]),
            forcelimited=_truth(model.actuator_forcelimited[k]),
            ctrllimited="false",
        )
        if model.actuator_ctrllimited[k]:
            # The control is q_ref + (kv/kp) q_ref': a range would cut the second term off.
            self._left_out.append(
                f"ctrlrange of actuator {self.file.actuators[k]}: the joint's own range counts"
            )
        _set(
            element,
            gear=model.actuator_gear[k],
            gainprm=model.actuator_gainprm[k],
            biasprm=model.actuator_biasprm[k],
            dynprm=model.actuator_dynprm[k],
        )
        _set_unless_zero(element, forcerange=model.actuator_forcerange[k])
        return element

    def _numerics(self, root: etree._Element) -> None:
        """Numbers of the file; the limits only of the driven joints."""
        model = self.model
        custom = etree.SubElement(root, "custom")
        for k in range(model.nnumeric):
            name = plain(model.numeric(k).name)
            start, size = model.numeric_adr[k], model.numeric_size[k]
            values = model.numeric_data[start : start + size]
            limits = name in (VELOCITY_LIMIT_NUMERIC, ACCELERATION_LIMIT_NUMERIC)
            if (
                limits and size == model.njnt
            ):  # else it speaks of driven joints alone, or is at fault
                values = values[list(self.driven)]
            new = etree.SubElement(custom, "numeric", name=name)
            _set(new, data=values)
        if not len(custom):
            root.remove(custom)

    def ties(self) -> Iterator[str]:
        """What ties driven joints to one another, or to what stands: a cell moves each for itself."""
        model = self.model
        for body in range(1, model.nbody):
            start, count = model.body_jntadr[body], model.body_jntnum[body]
            held = [j for j in range(start, start + count) if j not in self.driven]
            if len(held) < count and any(
                self._home[model.jnt_qposadr[j]] != model.qpos0[model.jnt_qposadr[j]] for j in held
            ):
                yield (
                    f"body {self.file.bodies[body]!r} has driven joints and held ones ({', '.join(self.file.joints[j] for j in held)}); "
                    "the held ones must stay at their zero"
                )
        for k in range(model.neq):
            if not self._is_within_one_link(self._ends_of_equality(k)):
                name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_EQUALITY, k) or f"number {k}"
                yield (
                    f"equality {name!r} ties driven joints, which a cell moves each for itself; "
                    "remove it, or drive only joints before it"
                )
        for k in range(model.ntendon):
            if self._acts(k) and not self._is_within_one_link(self._ends_of_tendon(k)):
                name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_TENDON, k) or f"number {k}"
                yield (
                    f"tendon {name!r} has a spring, damping, friction or limit on driven joints, which a cell does not carry; "
                    "remove it"
                )

    def _is_within_one_link(self, bodies: Iterable[int]) -> bool:
        return len({self._rigid[body] for body in bodies}) <= 1

    def _ends_of_equality(self, k: int) -> Iterator[int]:
        """Bodies that must not move against one another for the equality to say nothing."""
        model = self.model
        kind, ends = int(model.eq_type[k]), (int(model.eq_obj1id[k]), int(model.eq_obj2id[k]))
        if kind == mujoco.mjtEq.mjEQ_JOINT:
            for joint in ends:
                yield from self._ends_of_joint(joint)
        elif kind == mujoco.mjtEq.mjEQ_TENDON:
            for tendon in ends:
                yield from self._ends_of_tendon(tendon)
        elif int(model.eq_objtype[k]) == mujoco.mjtObj.mjOBJ_SITE:
            yield from (int(model.site_bodyid[site]) for site in ends)
        else:
            yield from (max(body, 0) for body in ends)

    def _ends_of_joint(self, joint: int) -> tuple[int, ...]:
        if joint not in self.driven:
            return ()
        body = int(self.model.jnt_bodyid[joint])
        return body, int(self.model.body_parentid[body])

    def _ends_of_tendon(self, k: int) -> Iterator[int]:
        model = self.model
        if k < 0:
            return
        for w in range(model.tendon_adr[k], model.tendon_adr[k] + model.tendon_num[k]):
            kind, number = model.wrap_type[w], int(model.wrap_objid[w])
            if kind == mujoco.mjtWrap.mjWRAP_JOINT:
                yield from self._ends_of_joint(number)
            elif kind == mujoco.mjtWrap.mjWRAP_SITE:
                yield int(model.site_bodyid[number])
            elif kind in (mujoco.mjtWrap.mjWRAP_SPHERE, mujoco.mjtWrap.mjWRAP_CYLINDER):
                yield int(model.geom_bodyid[number])

    def _acts(self, tendon: int) -> bool:
        """Whether a tendon does anything by itself, beside what an actuator does through it."""
        model = self.model
        return bool(
            model.tendon_stiffness[tendon]
            or model.tendon_damping[tendon]
            or model.tendon_frictionloss[tendon]
            or model.tendon_armature[tendon]
            or model.tendon_limited[tendon]
            or np.any(model.tendon_stiffnesspoly[tendon])
            or np.any(model.tendon_dampingpoly[tendon])
        )


def rigid_links(model: mujoco.MjModel, driven: Sequence[int]) -> list[int]:
    """For every body the first body of the link it belongs to, 0 for what stands still; bodies of one link never move apart."""
    groups = [0] * model.nbody
    for body in range(1, model.nbody):
        joints = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
        moves = any(joint in driven for joint in joints)
        groups[body] = body if moves else groups[int(model.body_parentid[body])]
    return groups


def _is_its_own_hull(model: mujoco.MjModel, mesh: int) -> bool:
    """Whether MuJoCo has made the convex hull of a mesh, and all vertices are on it."""
    start = int(model.mesh_graphadr[mesh])
    return start >= 0 and int(model.mesh_graph[start]) == int(model.mesh_vertnum[mesh])


def _vertices(model: mujoco.MjModel, mesh: int) -> NDArray[np.float32]:
    start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    return model.mesh_vert[start : start + count]


def _surface(model: mujoco.MjModel, mesh: int) -> bytes:
    """Vertices and faces of a compiled mesh in MuJoCo's binary format, which keeps them as they are."""
    vertices = _vertices(model, mesh)
    start, count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    faces = model.mesh_face[start : start + count]
    header = struct.pack("<4i", len(vertices), 0, 0, count)
    return header + vertices.astype("<f4").tobytes() + faces.astype("<i4").tobytes()


def _truth(value: object) -> str:
    return "true" if value else "false"


def _kind(enum: type, value: int) -> str:
    """MJCF's word for a number of one of MuJoCo's enums: `mjGAIN_FIXED` is `fixed`."""
    return enum(int(value)).name.split("_", 1)[1].lower()


def _shortest(values: NDArray[np.float32]) -> list[float]:
    """Single precision numbers with as few digits as they need."""
    return [float(str(value)) for value in values]


def _some(names: Sequence[str], most: int = 6) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def _set(element: etree._Element, **numbers: Sequence[float] | NDArray[np.float64]) -> None:
    """Set attributes with all digits, so that they are read back as they are."""
    for key, values in numbers.items():
        element.set(key, " ".join(repr(float(value)) for value in values))


def _set_unless_zero(
    element: etree._Element, **numbers: Sequence[float] | NDArray[np.float64]
) -> None:
    """Likewise, but MJCF's default of each of these is zero."""
    _set(element, **{key: values for key, values in numbers.items() if np.any(values)})
