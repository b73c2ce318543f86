"""Distances, directions and Jacobians against a second implementation and finite differences."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from workcell.control.proximity import PairGeometry
from workcell.errors import InputError, WorkcellError

from .conftest import build, update

_SOLIDS = {
    "sphere": 'type="sphere" size="0.06"',
    "capsule": 'type="capsule" size="0.05 0.2"',
    "box": 'type="box" size="0.1 0.12 0.08"',
    "cylinder": 'type="cylinder" size="0.1 0.1"',
    "ellipsoid": 'type="ellipsoid" size="0.1 0.12 0.08"',
    "mesh": 'type="mesh" mesh="block"',
    "plane": 'type="plane" size="1 1 1"',
}
_BLOCK = (
    '<mesh name="block" vertex="-.1 -.1 -.1 .1 -.1 -.1 .1 .1 -.1 -.1 .1 -.1'
    ' -.1 -.1 .1 .1 -.1 .1 .1 .1 .1 -.1 .1 .1"/>'
)


def _two_geoms(first: str, second: str):
    """A free body with the first geom, and the second fixed in the world."""
    return build(
        f'<geom name="b" {_SOLIDS[second]}/>'
        f'<body><freejoint/><geom name="a" {_SOLIDS[first]} mass="1"/></body>',
        [("a", "b")],
        _BLOCK,
    )


def _capsules(radius_a: float = 0.05, radius_b: float = 0.06):
    """Two capsules along their bodies' z axes, half lengths 0.2 m; a is free, b is fixed."""
    return build(
        f'<geom name="b" type="capsule" size="{radius_b} 0.2"/>'
        f'<body><freejoint/><geom name="a" type="capsule" size="{radius_a} 0.2" mass="1"/></body>',
        [("a", "b")],
    )


def _difference_jacobian(model, data, geometry, qpos, step=1e-6):
    """Central differences of the distances in the joint velocities (P, nv)."""
    columns = []
    for direction in np.eye(model.nv):
        sides = []
        for signed in (step, -step):
            moved = np.array(qpos, dtype=float)
            mujoco.mj_integratePos(model, moved, direction, signed)
            update(model, data, moved)
            sides.append(geometry.measure(data).distance_m)
        columns.append((sides[0] - sides[1]) / (2.0 * step))
    return np.array(columns).T


def _random_pose(rng, reach=0.35):
    rotation = rng.normal(size=4)
    return np.concatenate([rng.uniform(-reach, reach, 3), rotation / np.linalg.norm(rotation)])


def _segment_distance(p, u, q, v):
    """Distance of segments p +- u and q +- v: the interior optimum, else the best of four ends."""

    def to_segment(point, centre, half):
        s = np.clip((point - centre) @ half / (half @ half), -1.0, 1.0)
        return np.linalg.norm(point - centre - s * half)

    ends = [to_segment(p + k * u, q, v) for k in (-1, 1)]
    ends += [to_segment(q + k * v, p, u) for k in (-1, 1)]
    s, t = np.linalg.lstsq(np.stack([u, -v], axis=1), q - p, rcond=None)[0]
    if abs(s) <= 1.0 and abs(t) <= 1.0:
        ends.append(np.linalg.norm(p + s * u - q - t * v))
    return min(ends)


def test_two_arms_agree_with_a_second_implementation(two_arms, rng):
    model, data, geometry = two_arms
    for _ in range(20):
        update(model, data, rng.uniform(-2.0, 2.0, model.nq))
        near = geometry.measure(data)
        for k, (i, j) in enumerate(geometry.geom):
            half = [data.geom_xmat[g].reshape(3, 3)[:, 2] * model.geom_size[g, 1] for g in (i, j)]
            axis_distance = _segment_distance(
                data.geom_xpos[i], half[0], data.geom_xpos[j], half[1]
            )
            radii = model.geom_size[i, 0] + model.geom_size[j, 0]
            assert near.distance_m[k] == pytest.approx(axis_distance - radii, abs=1e-12)
        # The witness points must realise the distance along n, not only their number be right.
        rebuilt = (
            near.witness_j_m
            + (near.distance_m + geometry.radius_m.sum(axis=1))[:, None] * near.normal
        )
        np.testing.assert_allclose(rebuilt, near.witness_i_m, atol=1e-12)
        assert not near.degenerate.any()


def test_jacobian_of_two_arms_is_the_derivative_of_distance(two_arms, rng):
    model, data, geometry = two_arms
    penetrating = 0
    for _ in range(30):
        qpos = rng.uniform(-2.0, 2.0, model.nq)
        update(model, data, qpos)
        near = geometry.measure(data)
        penetrating += int((near.distance_m < 0.0).sum())
        differences = _difference_jacobian(model, data, geometry, qpos)
        np.testing.assert_allclose(near.jacobian, differences, atol=1e-8)
        qvel = rng.normal(size=model.nv)
        np.testing.assert_allclose(near.rate_m_s(qvel), near.jacobian @ qvel)
    assert penetrating > 5, "the states must include penetration for this test to mean something"


@pytest.mark.parametrize("gap_m", [0.1, 1e-3, 0.0, -1e-3, -0.1])
@pytest.mark.parametrize("tilt_rad", [1.0, 1e-3])
def test_jacobian_holds_near_contact_and_near_parallel(gap_m, tilt_rad):
    model, data, geometry = _capsules()
    qpos = [0.11 + gap_m, 0.0, 0.02, np.cos(tilt_rad / 2), np.sin(tilt_rad / 2), 0.0, 0.0]
    update(model, data, qpos)
    near = geometry.measure(data)
    assert near.distance_m[0] == pytest.approx(gap_m, abs=1e-12)
    # Turning by h slides the witness points by about L h / tilt^2, so only a small step stays
    # on the same pair of features.
    differences = _difference_jacobian(model, data, geometry, qpos, step=1e-8)
    np.testing.assert_allclose(near.jacobian, differences, atol=1e-6)


@pytest.mark.parametrize("height_m", [0.0, 0.1, 0.39])
def test_parallel_axes_have_an_admissible_answer(height_m):
    model, data, geometry = _capsules()
    update(model, data, [0.2, 0.0, height_m, 1.0, 0.0, 0.0, 0.0])
    near = geometry.measure(data)
    assert near.distance_m[0] == pytest.approx(0.2 - 0.11, abs=1e-12)
    np.testing.assert_allclose(near.normal[0], [1.0, 0.0, 0.0], atol=1e-12)
    assert near.witness_i_m[0, 2] == pytest.approx(near.witness_j_m[0, 2], abs=1e-12)


def test_normal_holds_until_the_axes_cross_and_is_flagged_there():
    model, data, geometry = _capsules()
    across = [np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0]  # The axis of a along y.
    for offset_m in (0.06, 1e-2, 1e-5, 1e-8):
        update(model, data, [offset_m, 0.0, 0.1, *across])
        near = geometry.measure(data)
        np.testing.assert_allclose(near.normal[0], [1.0, 0.0, 0.0], atol=1e-6)
        assert near.distance_m[0] == pytest.approx(offset_m - 0.11, abs=1e-12)
        assert not near.degenerate[0]
    update(model, data, [0.0, 0.0, 0.1, *across])
    near = geometry.measure(data)
    assert near.degenerate[0]
    assert near.distance_m[0] == pytest.approx(-0.11, abs=1e-12)
    np.testing.assert_allclose(np.abs(near.normal[0]), [1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(near.witness_i_m[0], [0.0, 0.0, 0.1], atol=1e-12)


def test_overlapping_collinear_axes_and_concentric_spheres_are_degenerate():
    model, data, geometry = _capsules()
    update(model, data, [0.0, 0.0, 0.03, 1.0, 0.0, 0.0, 0.0])
    near = geometry.measure(data)
    assert near.degenerate[0]
    assert near.distance_m[0] == pytest.approx(-0.11, abs=1e-12)
    assert near.normal[0, 2] == pytest.approx(0.0, abs=1e-12)
    model, data, geometry = _two_geoms("sphere", "sphere")
    update(model, data, [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    near = geometry.measure(data)
    assert near.degenerate[0]
    assert near.distance_m[0] == pytest.approx(-0.12, abs=1e-12)
    assert np.linalg.norm(near.normal[0]) == pytest.approx(1.0)


# Tolerances: what MuJoCo's solver for the pair gives at a difference step of 1e-5, see
# docs/theory.md section 2.
@pytest.mark.parametrize(
    ("first", "second", "tolerance"),
    [
        ("sphere", "capsule", 1e-7),
        ("sphere", "box", 1e-7),
        ("box", "sphere", 1e-7),
        ("capsule", "box", 1e-6),
        ("box", "capsule", 1e-6),
        ("capsule", "plane", 1e-7),
        ("capsule", "cylinder", 1e-4),
        ("ellipsoid", "sphere", 1e-4),
        ("capsule", "mesh", 1e-6),
        ("box", "plane", 1e-7),
        ("box", "box", 1e-4),
        ("mesh", "box", 1e-5),
    ],
)
def test_jacobian_for_every_kind_of_geom_separate_and_penetrating(first, second, tolerance, rng):
    model, data, geometry = _two_geoms(first, second)
    core_m = float(geometry.radius_m[0].sum()) or 0.05
    separate = penetrating = 0
    for _ in range(120):
        qpos = _random_pose(rng)
        update(model, data, qpos)
        near = geometry.measure(data)
        # Past the radius the axis is inside and the direction is documented as approximate;
        # within 10 um of contact two flat geoms change the branch inside the difference.
        if near.distance_m[0] < -0.9 * core_m or abs(near.distance_m[0]) < 1e-5:
            continue
        separate += near.distance_m[0] > 0.0
        penetrating += near.distance_m[0] < 0.0
        differences = _difference_jacobian(model, data, geometry, qpos, step=1e-5)
        np.testing.assert_allclose(near.jacobian, differences, atol=tolerance)
    assert separate > 20
    assert penetrating > 0


@pytest.mark.parametrize("first_is_round", [True, False])
def test_normal_against_a_box_holds_at_touching(first_is_round):
    model, data, geometry = _two_geoms(
        *(("sphere", "box") if first_is_round else ("box", "sphere"))
    )
    touching_m = 0.06 + 0.08
    for gap_m in (1e-3, 0.0, -1e-3, -0.03):
        update(model, data, [0.01, 0.02, touching_m + gap_m, 1.0, 0.0, 0.0, 0.0])
        near = geometry.measure(data)
        assert near.distance_m[0] == pytest.approx(gap_m, abs=1e-12)
        np.testing.assert_allclose(near.normal[0], [0.0, 0.0, 1.0], atol=1e-9)
        assert not near.degenerate[0]


def test_a_capsule_whose_axis_is_inside_a_box_never_reads_as_shallow_or_clear(rng):
    model, data, geometry = _two_geoms("capsule", "box")
    half_size = model.geom_size[model.geom("b").id]
    along = np.linspace(-0.2, 0.2, 401)
    inside = flagged = 0
    for _ in range(800):
        qpos = _random_pose(rng, reach=0.25)
        update(model, data, qpos)
        near = geometry.measure(data)
        axis = data.geom_xmat[model.geom("a").id].reshape(3, 3)[:, 2]
        points = qpos[:3] + along[:, None] * axis
        if (np.abs(points) < half_size).all(axis=1).any():
            inside += 1
            flagged += near.degenerate[0]
            assert near.distance_m[0] <= -0.05 + 1e-9
    assert inside > 50
    assert flagged > 20, "MuJoCo's shallow readings must occur, or the branch is untested"


def test_flat_geoms_at_touching_take_the_line_of_centres():
    model, data, geometry = _two_geoms("box", "box")
    update(model, data, [0.0, 0.0, 0.16, 1.0, 0.0, 0.0, 0.0])
    near = geometry.measure(data)
    assert near.degenerate[0]
    assert near.distance_m[0] == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(near.normal[0], [0.0, 0.0, 1.0], atol=1e-12)


def test_sign_follows_the_tree_whatever_its_shape():
    model, _, geometry = build(
        '<body><joint name="trunk" axis="0 0 1"/><geom name="t" type="sphere" size="0.1"/>'
        '  <body pos="1 0 0"><joint name="left" type="slide"/>'
        '    <geom name="l" type="sphere" size="0.1"/></body>'
        '  <body pos="-1 0 0"><body><joint name="right" type="ball"/>'
        '    <geom name="r" type="sphere" size="0.1" pos="0 0 1"/></body></body></body>'
        '<geom name="w" type="sphere" size="0.1" pos="0 0 3"/>',
        [("l", "r"), ("t", "l"), ("w", "r"), ("l", "w")],
    )
    trunk, left, right = 0, 1, slice(2, 5)
    assert (model.nv, len(geometry)) == (5, 4)
    assert geometry.sign[0, trunk] == 0, "the trunk moves both geoms alike"
    assert geometry.sign[0, left] == 1
    assert (geometry.sign[0, right] == -1).all()
    assert list(geometry.sign[1]) == [0, -1, 0, 0, 0]
    assert list(geometry.sign[2]) == [-1, 0, -1, -1, -1]
    assert list(geometry.sign[3]) == [1, 1, 0, 0, 0]


def test_a_pair_that_moves_together_keeps_its_distance_under_the_common_joint(rng):
    model, data, geometry = build(
        '<body><joint axis="0 1 0"/><geom name="t" type="sphere" size="0.1"/>'
        '<body pos="1 0 0"><joint axis="0 0 1"/>'
        '<geom name="l" type="capsule" size="0.1 0.2" pos="0.1 0.2 0"/></body></body>',
        [("t", "l")],
    )
    qpos = rng.normal(size=2)
    update(model, data, qpos)
    near = geometry.measure(data)
    differences = _difference_jacobian(model, data, geometry, qpos)
    assert differences[0, 0] == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(near.jacobian, differences, atol=1e-8)


def test_results_do_not_change_with_later_states_and_geometry_is_read_only(two_arms):
    model, data, geometry = two_arms
    update(model, data, np.zeros(model.nq))
    near = geometry.measure(data)
    kept = near.distance_m.copy(), near.surface_i_m.copy(), near.jacobian.copy()
    update(model, data, np.ones(model.nq))
    np.testing.assert_array_equal(near.distance_m, kept[0])
    np.testing.assert_array_equal(near.surface_i_m, kept[1])
    np.testing.assert_array_equal(near.jacobian, kept[2])
    with pytest.raises(ValueError, match="read-only"):
        geometry.sign[0, 0] = 5.0
    model.body_rootid[0] = model.body_rootid[0]  # The model itself stays the caller's to change.


def test_no_pairs_at_all():
    model, data, geometry = build('<body><joint/><geom size="0.1"/></body>', [])
    update(model, data, [0.0])
    near = geometry.measure(data)
    assert near.distance_m.shape == (0,)
    assert near.jacobian.shape == (0, 1)


def test_refusals_name_the_geoms_all_at_once():
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><asset><hfield name='land' nrow='2' ncol='2' size='1 1 1 1'/></asset>"
        "<worldbody><geom name='floor' type='plane' size='1 1 1'/>"
        "<geom name='hill' type='hfield' hfield='land'/>"
        "<geom name='rock' type='sphere' size='.1'/><body><joint/>"
        "<geom name='tray' type='box' size='.1 .1 .1'/><geom name='cup' size='.1'/></body>"
        "</worldbody><sensor><fromto name='s' geom1='tray' geom2='rock' cutoff='5'/>"
        "<fromto name='z' geom1='cup' geom2='rock'/></sensor></mujoco>"
    )
    pairs = [("floor", "hill"), ("tray", "cup"), ("rock", "tray"), ("cup", "rock")]
    ids = [(model.geom(i).id, model.geom(j).id) for i, j in pairs]
    with pytest.raises(InputError) as caught:
        PairGeometry(model, ids, [0, 0, 0, 6])
    text = str(caught.value)
    assert "pair floor - hill: heightfields and signed distance fields are not supported" in text
    assert "pair tray - cup: no joint moves one geom without the other" in text
    assert "pair rock - tray: sensor_adr 0 is not the address of a fromto sensor" in text
    assert "pair cup - rock: its fromto sensor has cutoff 0" in text
    with pytest.raises(InputError, match="sensor_adr has 1 entries; must be one for each pair"):
        PairGeometry(model, ids, [0])


def test_a_pair_beyond_its_cutoff_or_without_a_state_is_an_error():
    model, data, geometry = _capsules()
    with pytest.raises(WorkcellError, match="sensor of pair a - b reads zero"):
        geometry.measure(data)
    update(model, data, [200.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    with pytest.raises(WorkcellError, match="raise the cutoff"):
        geometry.measure(data)
    update(model, data, [1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    data.sensordata[2] = np.nan
    with pytest.raises(WorkcellError, match="the distance of pair a - b is not finite"):
        geometry.measure(data)
