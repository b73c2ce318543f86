"""Every link that can be hit is watched, and how far housing reaches out of its capsules is said."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests import cells
from tests.scene.test_normal_form import beside, leg
from workcell import assets
from workcell.errors import InputError
from workcell.scene import coverage

SHIN = '<geom name="shin_capsule" type="capsule" group="4" fromto="0 0 0 0.24 0 0" size="0.05" mass="0"/>'


def watched(cell) -> set[str]:
    return {cell.model.geom(g).name for g in cell.arms[1].geoms}


def changed(folder, *changes: tuple[str, str], **parts: str):
    path = leg(folder, **parts)
    text = path.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text)
    return beside(folder)


def test_a_link_with_capsules_is_watched_by_these_alone(tmp_path):
    leg(tmp_path)
    cell = cells.build(tmp_path, beside(tmp_path))
    assert watched(cell) == {f"arm1/{link}_capsule" for link in ("foot", "thigh", "shin")}


def test_a_link_without_capsules_is_watched_by_what_it_has(tmp_path):
    cell = cells.build(tmp_path, changed(tmp_path, (SHIN, "")))
    assert watched(cell) == {"arm1/foot_capsule", "arm1/thigh_capsule", "arm1/shin_beam"}
    others = {"arm0/link3_capsule"}
    seen = {h for g, h in cell.pairs.names if g == "arm1/shin_beam"} | {
        g for g, h in cell.pairs.names if h == "arm1/shin_beam"
    }
    assert others <= seen, "against the other arm"


def test_of_what_it_has_only_what_collides_counts(tmp_path):
    geoms = '<geom name="bump" pos="0.15 0 0" size="0.14" contype="1" mass="0.1"/><geom name="paint" pos="0.15 0 0" size="0.03"/>'
    cell = cells.build(tmp_path, changed(tmp_path, (SHIN, geoms)))
    assert watched(cell) == {"arm1/foot_capsule", "arm1/thigh_capsule", "arm1/bump"}


def test_an_arm_without_any_capsules_is_watched_by_all_it_has(tmp_path):
    content = changed(tmp_path, ('group="4"', 'group="3"'))
    assert len(watched(cells.build(tmp_path, content))) == 6


def test_a_part_inside_the_capsules_of_its_link_needs_none(tmp_path):
    inside = '<body name="chip" pos="0.1 0 0"><geom name="chip" size="0.01" mass="0.01"/></body>'
    leg(tmp_path, more=inside)
    assert "arm1/chip" not in watched(cells.build(tmp_path, beside(tmp_path)))


def test_a_part_beside_them_is_watched(tmp_path):
    beside_it = (
        '<body name="chip" pos="0.1 0 0.2"><geom name="chip" size="0.01" mass="0.01"/></body>'
    )
    leg(tmp_path, more=beside_it)
    assert "arm1/chip" in watched(cells.build(tmp_path, beside(tmp_path)))


def test_millimetres_outside_are_said_by_link(tmp_path):
    content = changed(tmp_path, ('size="0.12 0.02 0.02"', 'size="0.12 0.02 0.054"'))
    notes = cells.build(tmp_path, content).notes
    # The beam's far corners are (0.24, 0.02, 0.054); the capsule's axis ends at 0.24.
    outside = np.hypot(0.02, 0.054) - 0.05
    (note,) = [note for note in notes if "shin" in note]
    assert f"{1e3 * outside:.1f} mm out of what is watched (shin_beam)" in note


def test_more_than_d_min_is_refused_unless_the_scenario_allows_it(tmp_path):
    content = changed(tmp_path, ('size="0.12 0.02 0.02"', 'size="0.12 0.02 0.07"'))
    with pytest.raises(InputError, match=r"shin: housing shin_beam reaches 22\.8 mm") as refused:
        cells.build(tmp_path, content)
    assert "arm.arm1.allow_bare_housing = true" in str(refused.value)
    assert "control.d_min_m = 0.01" in str(refused.value)
    cells.build(tmp_path, content, "arm.arm1.allow_bare_housing=true")
    cells.build(tmp_path, content, "control.d_min_m=0.03")


def test_shipped_arms_are_covered(tmp_path):
    for name in assets.model_names():
        home = {"pa10": 7, "planar3": 3, "planar8": 8, "slider": 1}[name] * [0.0]
        content = {
            "name": name,
            "arm": [{"name": "a", "model": name, "home_rad": home, "operator": {"kind": "hold"}}],
        }
        assert cells.build(tmp_path / name, content).notes == ()


KINDS = {
    "sphere": "0.1",
    "capsule": "0.05 0.1",
    "cylinder": "0.05 0.1",
    "box": "0.05 0.1 0.15",
    "ellipsoid": "0.05 0.1 0.15",
}
NUMBER = st.floats(-0.4, 0.4).map(lambda x: round(x, 6))


@pytest.mark.parametrize("kind", KINDS)
@given(point=st.tuples(NUMBER, NUMBER, NUMBER))
def test_distances_are_never_more_than_mujocos(kind, point):
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody><geom type="{kind}" size="{KINDS[kind]}" pos="0.02 0 0" euler="20 30 0"/>'
        f'<body pos="{" ".join(map(str, point))}"><geom size="0.001"/></body></worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    true = mujoco.mj_geomDistance(model, data, 0, 1, 10.0, None) + 0.001
    (found,) = coverage._distance(model, data, 0, np.array([point]))
    assert found <= max(true, 0) + 1e-5
    if true > 1e-4 and kind != "ellipsoid":
        assert found == pytest.approx(true, abs=1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_points_of_a_surface_are_on_it_and_not_beyond(kind):
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody><geom type="{kind}" size="{KINDS[kind]}" euler="20 30 0"/></worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    points = coverage.surface(model, data, 0)
    distances = coverage._distance(model, data, 0, points)
    assert distances.max() < 1e-9
    if kind != "capsule":  # whose two balls have points within it too
        assert distances.min() > -1e-9
