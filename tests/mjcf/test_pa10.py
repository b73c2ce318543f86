"""The PA10 model against its sources: an own copy of the figures, an own forward kinematics."""

from __future__ import annotations

import dataclasses
import importlib
import re

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.mjcf.test_arms import ARMS, load, margins_m, tracking_errors_rad

PA10 = next(path for path in ARMS if path.stem == "pa10")
JOINTS = ["S1", "S2", "S3", "E1", "E2", "W1", "W2"]
RANGE_DEG = np.array([177, 91, 174, 137, 255, 165, 255])
STANDARD_RAD = np.deg2rad([45, 30, 0, 60, 0, 45, 0])

angles = st.tuples(*(st.floats(-limit, limit) for limit in np.deg2rad(RANGE_DEG)))


@pytest.fixture(scope="module")
def model() -> mujoco.MjModel:
    return load(PA10)


def denavit_hartenberg(q: np.ndarray) -> np.ndarray:
    """Flange pose (4, 4) from the standard Denavit-Hartenberg table, whose a are all 0."""
    pose = np.eye(4)
    offsets_m = [0.315, 0, 0.450, 0, 0.500, 0, 0.080]
    twists_deg = [-90, 90, -90, 90, -90, 90, 0]
    for theta, d, alpha in zip(q, offsets_m, np.deg2rad(twists_deg), strict=True):
        c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        pose = pose @ np.array(
            [[c, -s * ca, s * sa, 0], [s, c * ca, -c * sa, 0], [0, sa, ca, d], [0, 0, 0, 1]]
        )
    return pose


@given(q=angles)
@settings(deadline=None, max_examples=100)
def test_flange_is_where_the_dh_table_puts_it(model: mujoco.MjModel, q: tuple[float, ...]):
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    expected = denavit_hartenberg(np.array(q))
    flange = data.site("flange")
    np.testing.assert_allclose(flange.xpos, expected[:3, 3], atol=1e-12)
    np.testing.assert_allclose(flange.xmat.reshape(3, 3), expected[:3, :3], atol=1e-12)
    np.testing.assert_allclose(
        data.site("tool").xpos - flange.xpos, 0.12 * expected[:3, 2], atol=1e-12
    )
    # The elbow is where the axis of E1 passes, whatever turns beyond it.
    np.testing.assert_allclose(data.site("elbow").xpos, data.joint("E1").xanchor, atol=1e-12)


def test_zero_pose_is_straight_up_and_positive_pitch_leans_forward(model: mujoco.MjModel):
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(data.site("flange").xpos, [0, 0, 1.345], atol=1e-12)
    np.testing.assert_allclose(data.site("tool").xmat.reshape(3, 3), np.eye(3), atol=1e-12)
    for pitch in ("S2", "E1", "W1"):
        data.qpos[:] = 0
        data.joint(pitch).qpos[:] = 0.3
        mujoco.mj_kinematics(model, data)
        assert data.site("flange").xpos[0] > 0.02


def test_bodies_weigh_what_the_sources_say(model: mujoco.MjModel):
    figures = {  # mass kg, height of the centre of mass in the link frame m, inertia kg m^2
        "base": (3.04, 0.0765, (0.0193, 0.0193, 0.0184)),
        "link1": (9.78, 0.14818 + 0.0015 - 0.315, (0.0953, 0.0412, 0.0876)),
        "link2": (8.41, 0.06325, (0.1146, 0.1113, 0.0211)),
        "link3": (3.51, -0.08944, (0.0297, 0.0143, 0.0229)),
        "link4": (4.31, 0.04609, (0.0422, 0.0415, 0.0059)),
        "link5": (3.45, -0.1647, (0.0313, 0.0265, 0.0085)),
        "link6": (1.46, -0.030, (0.0066, 0.0067, 0.0009)),
        "link7": (0.24, -0.029, (8e-5, 8e-5, 15e-5)),
    }
    for name, (mass_kg, com_z_m, inertia_kg_m2) in figures.items():
        body = model.body(name)
        assert body.mass[0] == pytest.approx(mass_kg, abs=1e-12)
        np.testing.assert_allclose(body.ipos, [0, 0, com_z_m], atol=1e-9)
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, body.iquat)
        axes = rotation.reshape(3, 3)
        tensor = axes @ np.diag(body.inertia) @ axes.T
        np.testing.assert_allclose(tensor, np.diag(inertia_kg_m2), atol=1e-9)
    assert model.body_mass.sum() - model.body("tool").mass[0] == pytest.approx(34.20)


def test_joints_have_the_ranges_drives_and_limits_of_the_sources(model: mujoco.MjModel):
    assert [model.joint(i).name for i in range(model.njnt)] == JOINTS
    np.testing.assert_allclose(np.rad2deg(model.jnt_range[:, 1]), RANGE_DEG, atol=1e-5)
    np.testing.assert_array_equal(model.jnt_range[:, 0], -model.jnt_range[:, 1])
    armature = [0.75, 0.75, 0.2125, 0.2125, 0.0575, 0.0575, 0.0575]
    np.testing.assert_array_equal(model.dof_armature, armature)
    np.testing.assert_array_equal(model.dof_damping, [10, 10, 5, 5, 2, 2, 2])
    np.testing.assert_array_equal(model.jnt_actfrcrange[:, 1], [200, 200, 80, 80, 15, 15, 10])
    np.testing.assert_allclose(
        model.numeric("joint_velocity_limit_rad_s").data,
        [1, 1, 2, 2, 2, 2 * np.pi, 2 * np.pi],
        atol=1e-6,
    )
    np.testing.assert_allclose(
        np.rad2deg(model.numeric("joint_acceleration_limit_rad_s2").data),
        [95.5, 95.5, 191, 191, 191, 191, 191],
        atol=1e-5,
    )


def test_gains_follow_the_bandwidth_rule_in_the_heaviest_pose(model: mujoco.MjModel):
    data = mujoco.MjData(model)
    mass = np.zeros((model.nv, model.nv))
    rng = np.random.default_rng(3)
    heaviest = np.zeros(model.nv)
    poses = rng.uniform(*model.jnt_range.T, size=(1000, model.nv))
    right_angles = np.array(np.meshgrid(*[[0, np.pi / 2]] * 4)).reshape(4, -1).T
    corners = np.zeros((len(right_angles), model.nv))
    corners[:, [1, 3, 4, 5]] = right_angles
    for q in np.concatenate([poses, corners]):
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, mass)
        heaviest = np.maximum(heaviest, np.diag(mass))
    kp, kv = model.actuator_gainprm[:, 0], -model.actuator_biasprm[:, 2]
    frequency_hz = np.sqrt(kp / heaviest) / (2 * np.pi)
    np.testing.assert_allclose(frequency_hz[:4], 15, rtol=0.005)
    assert (frequency_hz[4:] > 15).all()
    np.testing.assert_allclose(model.dof_damping[4:] / kp[4:], 0.5e-3)
    damping_ratio = (kv + model.dof_damping) / (2 * np.sqrt(kp * heaviest))
    np.testing.assert_allclose(damping_ratio, 1, rtol=0.005)


def test_gravity_compensation_counts_against_the_torque_limit(model: mujoco.MjModel):
    weak = load(PA10)
    weak.jnt_actfrcrange[weak.joint("S2").id] = [-30, 30]
    torque_n_m = {}
    for name, arm in (("strong", model), ("weak", weak)):
        data = mujoco.MjData(arm)
        data.joint("S2").qpos[:] = np.pi / 2
        data.ctrl[:] = data.qpos
        mujoco.mj_forward(arm, data)
        torque_n_m[name] = data.joint("S2").qfrc_actuator[0]
    assert -90 < torque_n_m["strong"] < -80  # 80.7 N m of the arm alone, and the tool
    assert torque_n_m["weak"] == -30


def test_any_pose_is_held_against_gravity(model: mujoco.MjModel):
    rng = np.random.default_rng(11)
    for _ in range(5):
        data = mujoco.MjData(model)
        data.qpos[:] = q = rng.uniform(*model.jnt_range.T)
        data.ctrl[:] = q
        for _ in range(500):
            mujoco.mj_step(model, data)
        np.testing.assert_allclose(data.qpos, q, atol=1e-4)


def test_a_released_error_dies_out_without_ringing(model: mujoco.MjModel):
    data = mujoco.MjData(model)
    data.qpos[:] = STANDARD_RAD + 1e-3
    data.ctrl[:] = STANDARD_RAD
    for _ in range(150):
        mujoco.mj_step(model, data)
        assert (data.qpos - STANDARD_RAD > -2e-4).all()
    np.testing.assert_allclose(data.qpos, STANDARD_RAD, atol=2e-5)


@pytest.mark.parametrize("signs", [(1,) * 7, (1, -1, 1, -1, 1, -1, 1)], ids=["together", "opposed"])
def test_all_joints_at_one_rad_s_lag_less_than_a_milliradian(model: mujoco.MjModel, signs):
    end = STANDARD_RAD + np.array(signs) * 1.0
    assert tracking_errors_rad(model, STANDARD_RAD, end, peak=1.0).max() < 1e-3


def test_watched_capsules_are_the_eight_the_readme_lists_with_their_margins(model: mujoco.MjModel):
    text = PA10.with_name("README.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\w+_capsule) \|.*\| ([\d.]+) \|$", text, flags=re.MULTILINE)
    listed_mm = {name: float(margin) for name, margin in rows}
    assert set(listed_mm) == {"base_capsule", "tool_capsule"} | {
        f"link{i}_capsule" for i in range(1, 7)
    }
    measured = margins_m(model, samples=20)
    for name, margin_m in measured.items():
        # The generator's polygons stand around the circles, so it states a little less.
        assert listed_mm[name] <= 1e3 * margin_m < listed_mm[name] + 0.1, name


def test_flange_stays_in_the_wrist_capsule_at_any_roll(model: mujoco.MjModel):
    data = mujoco.MjData(model)
    capsule = model.geom("link6_capsule")
    for roll in np.linspace(*model.jnt_range[6], 25):
        data.joint("W2").qpos[:] = roll
        mujoco.mj_kinematics(model, data)
        axis = data.geom("link6_capsule").xmat.reshape(3, 3)[:, 2]
        centre = data.geom("link6_capsule").xpos
        for angle in np.linspace(0, 2 * np.pi, 90):
            rim = np.array([0.033 * np.cos(angle), 0.033 * np.sin(angle), 0.005])
            link7 = data.body("link7")
            offset = link7.xpos + link7.xmat.reshape(3, 3) @ rim - centre
            offset = offset - np.clip(offset @ axis, -capsule.size[1], capsule.size[1]) * axis
            assert np.linalg.norm(offset) < capsule.size[0]


def test_frustum_hulls_stand_around_their_cones(model: mujoco.MjModel):
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    geom = model.geom("link2_collar").id
    start = model.mesh_vertadr[model.geom_dataid[geom]]
    count = model.mesh_vertnum[model.geom_dataid[geom]]
    world = model.mesh_vert[start : start + count] @ data.geom_xmat[geom].reshape(3, 3).T
    world = world + data.geom_xpos[geom] - [0, 0, 0.315]
    for height_m, radius_m in ((0.092, 0.067), (0.105, 0.050)):
        ring = world[np.abs(world[:, 2] - height_m) < 1e-6, :2]
        ring = ring[np.argsort(np.arctan2(ring[:, 1], ring[:, 0]))]
        assert len(ring) == 24
        edge_middles = (ring + np.roll(ring, -1, axis=0)) / 2
        np.testing.assert_allclose(np.linalg.norm(edge_middles, axis=1), radius_m, atol=1e-6)


@pytest.fixture
def generator(monkeypatch: pytest.MonkeyPatch):
    """The script beside the model, which is no part of the package."""
    monkeypatch.syspath_prepend(PA10.parent)
    return importlib.import_module("make_pa10")


def test_the_file_is_what_its_generator_writes(generator, tmp_path):
    written = tmp_path / "pa10.xml"
    generator.main([str(written)])
    assert written.read_bytes() == PA10.read_bytes()


def test_a_capsule_that_misses_housing_is_refused(generator, monkeypatch: pytest.MonkeyPatch):
    tight = [dataclasses.replace(c, radius=c.radius - 1) for c in generator.CAPSULES]
    monkeypatch.setattr(generator, "CAPSULES", tight)
    with pytest.raises(ValueError, match=r"base_capsule: the housing sticks out by 0\.8\d+ mm"):
        generator.build()
