"""What every shipped arm file must offer a scenario (mjcf/README.md), over all of them."""

from __future__ import annotations

import itertools
from pathlib import Path

import mujoco
import numpy as np
import pytest
from dm_control import mjcf

ARMS = sorted(Path(__file__).parents[2].joinpath("mjcf").glob("*/*.xml"))
HOUSING, WATCHED = 2, 4
TIMESTEP_S = 0.002

arms = pytest.mark.parametrize("path", ARMS, ids=lambda path: path.stem)


def load(path: Path) -> mujoco.MjModel:
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.timestep = TIMESTEP_S
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return model


def surface_points(model: mujoco.MjModel, geom: int) -> np.ndarray:
    """Points (n, 3) all over the surface of a housing geom, in the frame of the geom."""
    grid = np.linspace(-1, 1, 9)
    size = model.geom_size[geom]
    kind = model.geom_type[geom]
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        cube = np.array(list(itertools.product(grid, repeat=3)))
        return cube[np.abs(cube).max(axis=1) == 1] * size
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        angle = np.linspace(0, 2 * np.pi, 720, endpoint=False)
        circle = size[0] * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
        side = [circle + np.array([0, 0, size[1] * height]) for height in grid]
        caps = [
            circle * share + np.array([0, 0, end * size[1]])
            for share in (0, 0.5)
            for end in (-1, 1)
        ]
        return np.concatenate(side + caps)
    assert kind == mujoco.mjtGeom.mjGEOM_MESH, "a kind of housing this test has no surface for"
    mesh = model.geom_dataid[geom]
    start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    return model.mesh_vert[start : start + count].astype(float)


def watching_capsule(model: mujoco.MjModel, body: int) -> int:
    """The watched capsule of the body or, failing that, of the nearest body before it."""
    while True:
        own = np.flatnonzero((model.geom_bodyid == body) & (model.geom_group == WATCHED))
        if len(own):
            return int(own[0])
        assert body, "a body that no capsule watches over"
        body = model.body_parentid[body]


def margins_m(model: mujoco.MjModel, samples: int = 5) -> dict[str, float]:
    """Least depth of the housing below the surface of each watched capsule, over random poses."""
    data = mujoco.MjData(model)
    rng = np.random.default_rng(7)
    margins: dict[str, float] = {}
    for _ in range(samples):
        data.qpos[:] = rng.uniform(*model.jnt_range.T)
        mujoco.mj_kinematics(model, data)
        for geom in np.flatnonzero(model.geom_group == HOUSING):
            capsule = watching_capsule(model, model.geom_bodyid[geom])
            world = surface_points(model, geom) @ data.geom_xmat[geom].reshape(3, 3).T
            world += data.geom_xpos[geom] - data.geom_xpos[capsule]
            local = world @ data.geom_xmat[capsule].reshape(3, 3)
            radius, half_length, _ = model.geom_size[capsule]
            local[:, 2] -= np.clip(local[:, 2], -half_length, half_length)
            margin = radius - np.linalg.norm(local, axis=1).max()
            name = model.geom(capsule).name
            margins[name] = min(margin, margins.get(name, np.inf))
    return margins


def tracking_errors_rad(model: mujoco.MjModel, start: np.ndarray, end: np.ndarray, peak: float):
    """Largest error of each joint on a minimum-jerk move whose fastest joint reaches `peak`.

    The servo law is the controller's: the reference is led by kv/kp times its velocity.
    """
    data = mujoco.MjData(model)
    data.qpos[:] = start
    lead_s = -model.actuator_biasprm[:, 2] / model.actuator_gainprm[:, 0]
    duration_s = 1.875 * np.abs(end - start).max() / peak
    largest = np.zeros(model.nv)
    for tick in range(int(1.2 * duration_s / TIMESTEP_S)):
        s = min(tick * TIMESTEP_S / duration_s, 1.0)
        q = start + (end - start) * s**3 * (10 - 15 * s + 6 * s**2)
        qd = (end - start) * 30 * s**2 * (1 - s) ** 2 / duration_s
        data.ctrl[:] = q + lead_s * qd
        largest = np.maximum(largest, np.abs(data.qpos - q))
        mujoco.mj_step(model, data)
    return largest


def test_all_arms_are_seen():
    assert {path.stem for path in ARMS} == {"pa10", "planar3", "planar8", "slider"}


@arms
def test_two_of_it_attach_to_one_scene(path: Path):
    scene = mjcf.RootElement(model="cell")
    for name, y in (("left", 0.6), ("right", -0.6)):
        arm = mjcf.from_path(str(path))
        arm.model = name
        scene.worldbody.add("site", name=f"{name}_base", pos=[0, y, 0]).attach(arm)
    model = mujoco.MjModel.from_xml_string(scene.to_xml_string(), scene.get_assets())
    single = load(path)
    assert model.nq == 2 * single.nq
    assert model.nu == 2 * single.nu
    assert model.body_mass.sum() == pytest.approx(2 * single.body_mass.sum(), rel=1e-12)
    for name in ("left", "right"):
        np.testing.assert_array_equal(
            model.numeric(f"{name}/joint_velocity_limit_rad_s").data,
            single.numeric("joint_velocity_limit_rad_s").data,
        )
        assert model.site(f"{name}/tool").id >= 0


@arms
def test_everything_is_named_and_nothing_stands_in_the_way_of_attaching(path: Path):
    root = mjcf.from_path(str(path))
    assert root.model == path.stem == path.parent.name
    for kind in ("body", "joint", "geom", "site", "actuator", "mesh", "numeric"):
        for element in root.find_all(kind):
            assert element.name, f"{kind} without a name: {element.to_xml_string()[:200]}"
            assert "/" not in element.name
    assert not root.keyframe.all_children()
    assert root.compiler.angle == "radian"


@arms
def test_joints_actuators_and_limits_match_one_to_one(path: Path):
    model = load(path)
    assert np.isin(model.jnt_type, [mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE]).all()
    assert [model.actuator(i).name for i in range(model.nu)] == [
        model.joint(i).name for i in range(model.njnt)
    ]
    assert not model.actuator_ctrllimited.any(), "a control range would cut off the velocity lead"
    assert model.jnt_limited.all()
    assert model.jnt_actfrclimited.all()
    assert model.jnt_actgravcomp.all()
    assert (model.body_gravcomp[1:] == 1).all()
    for name in ("joint_velocity_limit_rad_s", "joint_acceleration_limit_rad_s2"):
        limits = model.numeric(name).data
        assert limits.shape == (model.njnt,)
        assert (limits > 0).all()


@arms
def test_geoms_are_housing_or_watched_and_never_bounce(path: Path):
    model = load(path)
    assert set(model.geom_group) == {HOUSING, WATCHED}
    assert not model.geom_contype.any()
    assert not model.geom_conaffinity.any()
    watched = model.geom_group == WATCHED
    assert (model.geom_type[watched] == mujoco.mjtGeom.mjGEOM_CAPSULE).all()
    assert all(model.geom(g).name.endswith("_capsule") for g in np.flatnonzero(watched))


@arms
def test_every_capsule_contains_its_housing_and_the_tool_point(path: Path):
    model = load(path)
    margins = margins_m(model)
    assert len(margins) == (model.geom_group == WATCHED).sum()
    assert min(margins.values()) >= 0, margins
    # A loose capsule would pass as well: some piece must come near the surface.
    assert max(margins.values()) < 0.005, margins

    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    tool = data.site("tool").xpos
    capsule = watching_capsule(model, model.site_bodyid[model.site("tool").id])
    along = data.geom_xmat[capsule].reshape(3, 3)[:, 2]
    offset = tool - data.geom_xpos[capsule]
    radius, half_length, _ = model.geom_size[capsule]
    offset = offset - np.clip(offset @ along, -half_length, half_length) * along
    assert np.linalg.norm(offset) < radius


@arms
def test_servos_track_a_move_within_a_milliradian(path: Path):
    model = load(path)
    velocity = model.numeric("joint_velocity_limit_rad_s").data
    acceleration = model.numeric("joint_acceleration_limit_rad_s2").data
    reach = np.minimum(1.0, model.jnt_range[:, 1])
    start, end = -reach / 2, reach / 2
    # A minimum-jerk move of length d at peak speed v peaks at an acceleration of 1.64 v^2 / d.
    peak = min(1.0, velocity.min(), np.sqrt(acceleration.min() * reach.max() / 1.643))
    assert tracking_errors_rad(model, start, end, peak).max() < 1e-3


@arms
def test_running_it_raises_no_warning(path: Path):
    model = load(path)
    data = mujoco.MjData(model)
    for _ in range(200):
        mujoco.mj_step(model, data)
    assert not any(warning.number for warning in data.warning)
    np.testing.assert_allclose(data.qpos, 0, atol=1e-9)
