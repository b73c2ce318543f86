"""An imported arm is the original with capsules, housing, servos and limits, and it runs at once."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from tests.scene.test_arm_part import FINGER, SECOND
from tests.scene.test_normal_form import leg
from workcell import scenario
from workcell.cli import main
from workcell.errors import InputError
from workcell.scene import cell as scene
from workcell.scene.adapt import Wishes, adapt
from workcell.scene.adapt.capsules import fit, fit_one
from workcell.scene.adapt.hulls import MOST_CORNERS, hull_corners
from workcell.scene.adapt.limits import PUBLISHED, published
from workcell.scene.contacts import hand_bodies, meeting_pairs
from workcell.scene.hand import tool_body

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
BALL = '<asset><mesh name="ball" vertex="{}"/></asset>'.format(
    " ".join(
        f"{0.05 * np.cos(a) * np.cos(b):.6f} {0.05 * np.sin(a) * np.cos(b):.6f} {0.05 * np.sin(b):.6f}"
        for b in np.linspace(-1.5, 1.5, 20)
        for a in np.linspace(0, 6.2, 24)
    )
)
MESH = '<geom name="ball" type="mesh" mesh="ball" pos="0.1 0 0" contype="1" mass="0.1"/>'


def beyond(capsules, points: np.ndarray) -> float:
    return float(np.min([capsule.beyond(points) for capsule in capsules], axis=0).max())


@settings(max_examples=4, deadline=None)
@given(
    seed=st.integers(0, 1000),
    scale=st.tuples(st.floats(0.01, 0.3), st.floats(0.01, 0.3), st.floats(0.01, 0.3)),
)
def test_capsules_contain_every_corner_and_all_between(seed, scale):
    rng = np.random.default_rng(seed)
    piece = hull_corners(rng.normal(size=(40, 3)) * scale)
    capsules = fit([piece])
    assert 1 <= len(capsules) <= 3
    assert beyond(capsules, piece) <= 0
    between = rng.dirichlet(np.ones(len(piece)), 300) @ piece
    assert beyond(capsules, between) <= 0


def test_the_points_of_a_capsule_get_that_capsule():
    rng = np.random.default_rng(0)
    points = rng.normal(size=(800, 3))
    points *= 0.05 / np.linalg.norm(points, axis=1)[:, None]
    points[::2, 2] += 0.3
    found = fit_one(points)
    assert found.radius_m == pytest.approx(0.05, rel=0.05)
    assert found.length_m == pytest.approx(0.3, rel=0.05)


def test_an_angle_gets_two_capsules():
    upright, level = CUBE * [0.05, 0.05, 0.5], CUBE * [0.5, 0.05, 0.05]
    assert len(fit([upright])) == 1
    two = fit([upright, level])
    assert len(two) >= 2
    assert sum(c.volume_m3 for c in two) < 0.8 * fit_one(np.concatenate([upright, level])).volume_m3


def test_a_hull_of_many_corners_becomes_a_coarser_one_around_it():
    rng = np.random.default_rng(1)
    points = rng.normal(size=(5000, 3))
    points *= np.array([0.3, 0.04, 0.04]) / np.linalg.norm(points, axis=1)[:, None]
    corners = hull_corners(points)
    planes = ConvexHull(corners).equations
    assert (points @ planes[:, :3].T + planes[:, 3]).max() <= 1e-9
    assert ConvexHull(corners).volume < 1.25 * ConvexHull(points).volume
    assert len(corners) < 3 * MOST_CORNERS


def test_a_flat_mesh_is_thickened():
    corners = hull_corners(CUBE * [0.1, 0.1, 0.0])
    assert np.ptp(corners, axis=0).min() == pytest.approx(1e-3)


def imported(folder, wishes: Wishes = Wishes(), **parts: str):  # noqa: B008
    path = leg(folder, **parts)
    before = path.read_bytes()
    adapted = adapt(path, wishes)
    assert path.read_bytes() == before, "the original is not touched"
    (folder / "out.xml").write_text(adapted.xml)
    return adapted, mujoco.MjModel.from_xml_path(str(path))


def test_it_is_the_original_in_tool_mass_and_inertia(tmp_path):
    adapted, original = imported(
        tmp_path, Wishes(tool="tool"), foot='euler="0 0 90"', more=FINGER + MESH, assets=BALL
    )
    model = mujoco.MjModel.from_xml_string(adapted.xml)
    assert model.njnt == 2
    assert any("locked, mass and geometry merged: grip = 0" in line for line in adapted.did)
    for q in np.random.default_rng(0).uniform(-2, 2, (20, 2)):
        data, there = mujoco.MjData(model), mujoco.MjData(original)
        data.qpos[:], there.qpos[:2] = q, q
        mujoco.mj_forward(model, data)
        mujoco.mj_forward(original, there)
        np.testing.assert_allclose(data.site("tool").xpos, there.site("tool").xpos, atol=1e-9)
        mine, theirs = np.zeros((2, 2)), np.zeros((3, 3))
        mujoco.mj_fullM(model, data, mine)
        mujoco.mj_fullM(original, there, theirs)
        np.testing.assert_allclose(mine, theirs[:2, :2], atol=1e-9)
    assert model.body_mass.sum() == pytest.approx(original.body_mass.sum(), abs=1e-9)


def test_its_capsules_contain_its_housing(tmp_path):
    imported(tmp_path, more=MESH, assets=BALL)
    content = scenario.validate(
        {
            "name": "one",
            "arm": [
                {
                    "name": "one",
                    "model": str(tmp_path / "out.xml"),
                    "home_rad": [0.3, 0.4],
                    "operator": {"kind": "hold"},
                }
            ],
        },
        None,
    )
    cell = scene.build(content, tmp_path / "scene")
    assert cell.notes == ()
    assert {cell.model.geom_group[g] for g in cell.arms[0].geoms} == {4}


def test_twice_gives_the_same_bytes(tmp_path):
    texts = {adapt(leg(tmp_path, more=MESH, assets=BALL), Wishes()).xml for _ in range(2)}
    assert len(texts) == 1


def test_a_root_leaves_out_what_is_not_below_it(tmp_path):
    adapted, original = imported(tmp_path, Wishes(tool="tool", root="thigh"), world=SECOND)
    model = mujoco.MjModel.from_xml_string(adapted.xml)
    assert [model.joint(j).name for j in range(model.njnt)] == ["knee"]
    assert model.body_mass.sum() == pytest.approx(
        original.body("thigh").mass[0] + original.body("shin").mass[0], abs=1e-9
    )


def test_a_body_with_an_offset_can_be_the_tool(tmp_path):
    adapted, _ = imported(tmp_path, Wishes(tool="shin", tool_offset_m=(0.25, 0.0, 0.0)))
    model = mujoco.MjModel.from_xml_string(adapted.xml)
    np.testing.assert_allclose(model.site("tool").pos, [0.25, 0, 0], atol=1e-12)


def test_torque_limits_of_motors_and_gears_are_kept(tmp_path):
    path = leg(tmp_path)
    whole = '<position name="hip" joint="hip" kp="900" kv="30"/>'
    motor = '<motor name="hip" joint="hip" gear="50" ctrlrange="-1 2"/>'
    path.write_text(path.read_text().replace(whole, motor))
    adapted = adapt(path, Wishes())
    model = mujoco.MjModel.from_xml_string(adapted.xml)
    np.testing.assert_array_equal(model.jnt_actfrcrange[model.joint("hip").id], [-50, 100])
    assert any("torque limits of knee: none stated" in line for line in adapted.unknown)


@pytest.mark.parametrize(
    ("wishes", "words"),
    [
        (Wishes(tool="tol"), "--tool tol: no such site or body; allowed: tool, foot, thigh, shin"),
        (Wishes(root="leg"), "--root leg: no such body"),
        (Wishes(locked={"hup": 0.0}), "--lock hup: no such joint; allowed: hip, knee"),
        (Wishes(tool="foot"), "--tool foot: no joint moves it"),
        (Wishes(tool="foot", root="shin"), "--tool foot: is not below --root shin"),
    ],
)
def test_a_wish_that_cannot_be_is_refused_by_name(tmp_path, wishes, words):
    with pytest.raises(InputError) as refused:
        adapt(leg(tmp_path), wishes)
    assert words in str(refused.value)


def test_published_limits_have_a_source_and_are_found_by_name():
    assert all(entry.source and min(entry.velocity_rad_s) > 0 for entry in PUBLISHED)
    found = published("my_panda", 7)
    assert found is not None
    assert found.velocity_rad_s[0] == 2.175
    assert published("my_panda", 6) is None
    assert published("nobody", 7) is None


def test_the_command_writes_an_arm_a_picture_and_a_scenario_that_can_be_run(tmp_path, capsys):
    path = leg(tmp_path, more=FINGER)
    for _ in range(2):
        assert main(["import", str(path), "--name", "mine", "--out", str(tmp_path / "arms")]) == 0
    said = capsys.readouterr().out
    assert "home_rad = [" in said
    assert "first scenario: workcell run" in said
    folder = tmp_path / "arms" / "mine"
    assert sorted(p.name for p in folder.iterdir()) == ["mine.png", "mine.xml", "mine_pair.toml"]
    assert main(["check", str(folder / "mine_pair.toml")]) == 0


@pytest.mark.parametrize("lock", ["hip", "=1", "hip=x"])
def test_a_lock_that_is_no_assignment_is_refused(tmp_path, capsys, lock):
    assert main(["import", str(leg(tmp_path)), "--lock", lock, "--out", str(tmp_path)]) == 2
    assert f"--lock {lock}" in capsys.readouterr().err


def test_the_original_is_never_replaced(tmp_path, capsys):
    folder = tmp_path / "leg"
    path = leg(folder)
    assert main(["import", str(path), "--name", "leg", "--out", str(tmp_path)]) == 2
    assert "would replace the original" in capsys.readouterr().err


def test_a_tool_on_a_link_without_geometry_meets_with_the_link_before(tmp_path):
    bare = '<body name="flange" pos="0.25 0 0"><joint name="roll" axis="1 0 0" range="-90 90"/><inertial pos="0 0 0" mass="0.01" diaginertia="1e-5 1e-5 1e-5"/><site name="tip" zaxis="1 0 0"/></body>'
    imported(tmp_path, Wishes(tool="tip"), more=bare)
    arm = {"model": str(tmp_path / "out.xml"), "home_rad": [0.3, 0.4, 0.0]}
    operator, job = {"kind": "hold"}, [{"kind": "meet", "arm": "one"}]
    content = {
        "name": "pair",
        "arm": [
            arm | {"name": "one", "operator": operator},
            arm | {"name": "two", "base_position_m": [0.0, 0.9, 0.0], "job": job},
        ],
    }
    cell = scene.build(scenario.validate(content, None), tmp_path / "scene")
    names = {cell.model.body(tool_body(cell.model, arm)).name for arm in cell.arms}
    assert names == {"one/shin", "two/shin"}
    assert meeting_pairs(cell)
    hand = {cell.model.body(b).name for b in hand_bodies(cell.model, cell.arms[0])}
    assert hand >= {"one/flange", "one/shin", "one/thigh"}, "the bare link counts for none"


def test_an_instrument_is_held_before_all_of_the_hand(tmp_path):
    imported(tmp_path, Wishes(tool="shin", tool_offset_m=(0.1, 0.0, 0.0)))
    arm = {"name": "one", "model": str(tmp_path / "out.xml"), "home_rad": [0.3, 0.4]}
    held = {"name": "rod", "held_by": "one"}
    content = {
        "name": "one",
        "arm": [arm | {"operator": {"kind": "hold"}}],
        "instrument": [held],
    }
    cell = scene.build(scenario.validate(content, None), tmp_path / "scene")
    data = mujoco.MjData(cell.model)
    cell.place_home(data)
    mujoco.mj_kinematics(cell.model, data)
    hand = [cell.model.geom(g).name for g in cell.arms[0].geoms][-1]
    gap = mujoco.mj_geomDistance(
        cell.model, data, cell.model.geom(hand).id, cell.instruments[0].geom, 1.0, None
    )
    assert hand.startswith("one/shin")
    assert gap >= cell.scenario.control.d_min_m - 1e-9
