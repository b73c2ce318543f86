"""What is kept from scene to scene changes nothing: not the scene, not a refusal, not when a file has changed."""

from __future__ import annotations

import copy
import os
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from lxml import etree

from tests import cells
from tests.scene import plain
from tests.scene.test_addresses import own_model
from tests.scene.test_compose import mixed
from workcell import assets, scenario
from workcell.errors import InputError
from workcell.scene import arm_file, arm_part, compose, pairs
from workcell.scene import cell as scene
from workcell.scene.addresses import arm_addresses, instrument_addresses
from workcell.scene.pairs import APART_M, FEW_SAMPLES, SAMPLES

# A tetrahedron.
_MESH = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 {}\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


def laden(folder: Path) -> dict:
    """A cell of two arms, one of them with what arm files may have: an include, a mesh, sensors, a light, options."""
    content = own_model(
        folder,
        {
            "</worldbody>": '<light pos="0 0 1"/></worldbody><sensor><clock/><jointpos joint="X"/></sensor>',
            "<worldbody>": '<include file="parts/more.xml"/><option gravity="0 0 -9"/><compiler meshdir="shapes"/>'
            '<asset><mesh name="tip" file="tip.obj"/></asset>'
            '<worldbody><geom name="tip" type="mesh" mesh="tip" mass="0.1"/>',
        },
    )
    (folder / "parts").mkdir(exist_ok=True)
    (folder / "shapes").mkdir(exist_ok=True)
    more = '<mujoco><custom><numeric name="more" data="1"/></custom></mujoco>'
    (folder / "parts" / "more.xml").write_text(more)
    (folder / "shapes" / "tip.obj").write_text(_MESH.format(0.1))
    second = mixed("slider", "planar3")["arm"][1]
    return content | {"arm": [*content["arm"], second]}


def written(folder: Path) -> str:
    return (folder / compose.SCENE_FILE).read_text()


@pytest.mark.parametrize("name", assets.scenario_names())
def test_scenes_are_written_as_dm_control_alone_writes_them(tmp_path, name):
    asked = scenario.load(name)
    for again in ("first", "second"):
        cell = scene.build(asked, tmp_path / again)
        assert written(tmp_path / again) == plain.scene_xml(asked, cell.pairs.names)


def test_so_is_an_arm_with_all_that_its_file_may_have(tmp_path):
    asked = cells.load(tmp_path, laden(tmp_path))
    cell = scene.build(asked, tmp_path / "scene")
    assert cell.model.nmesh == 1
    assert cell.model.nsensor == len(cell.pairs), (
        "an arm's own sensors are left out, and that is said"
    )
    assert any("2 sensors" in note for note in cell.notes)
    assert any("gravity" in note for note in cell.notes)
    assert cell.model.opt.gravity[2] == -9.81
    assert written(tmp_path / "scene") == plain.scene_xml(asked, cell.pairs.names)


NUMBER = st.floats(-2, 2, allow_subnormal=False)
LENGTH = st.floats(1e-3, 1)
VECTOR = st.tuples(NUMBER, NUMBER, NUMBER)


@settings(
    max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    boxes=st.lists(st.tuples(st.tuples(LENGTH, LENGTH, LENGTH), VECTOR), max_size=3),
    rods=st.lists(st.tuples(LENGTH, LENGTH, LENGTH, VECTOR), max_size=3),
    base=VECTOR,
    angle=NUMBER,
)
def test_and_any_numbers(tmp_path, boxes, rods, base, angle):
    content = cells.duet()
    turn = [np.cos(angle), 0.0, -0.0, np.sin(angle)]
    content["arm"][0] |= {"base_position_m": list(base), "base_wxyz": turn}
    content["obstacle"] = [
        {"name": f"box{k}", "shape": "box", "size_m": list(size), "position_m": list(position)}
        for k, (size, position) in enumerate(boxes)
    ]
    content["instrument"] = [
        {
            "name": f"rod{k}",
            "radius_m": radius,
            "half_length_m": half,
            "mass_kg": mass,
            "position_m": list(position),
        }
        for k, (radius, half, mass, position) in enumerate(rods)
    ]
    asked = cells.load(tmp_path, content)
    composed = compose.compose(asked)
    watched = (("surgeon/link3_capsule", "floor"), ("floor", "nurse/link3_capsule"))
    compose.add_sensors(composed, watched, 100)
    text = etree.tostring(composed.tree, pretty_print=True, encoding="unicode")
    assert text == plain.scene_xml(asked, watched)


@pytest.mark.parametrize("file", ["own.xml", "parts/more.xml", "shapes/tip.obj"])
def test_a_change_of_any_file_is_seen_whatever_its_date_says(tmp_path, file):
    asked = cells.load(tmp_path, laden(tmp_path))
    scene.build(asked, tmp_path / "before")
    before = written(tmp_path / "before")
    path = tmp_path / file
    date, size = path.stat().st_mtime_ns, path.stat().st_size
    old, new = {"own.xml": ("372", "371"), "shapes/tip.obj": ("0 0 0.1", "0 0 0.2")}.get(
        file, ('data="1"', 'data="2"')
    )
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    os.utime(path, ns=(date, date))
    assert path.stat().st_size == size
    scene.build(asked, tmp_path / "after")
    assert written(tmp_path / "after") != before
    path.write_text(path.read_text().replace(new, old))
    scene.build(asked, tmp_path / "restored")
    assert written(tmp_path / "restored") == before


def test_arms_of_one_file_share_nothing(tmp_path):
    content = mixed("slider", "slider")
    one = cells.build(tmp_path / "one", content)
    first = written(tmp_path / "one" / "scene")
    content["arm"][1] |= {"name": "other", "base_position_m": [0.0, 2.0, 0.0]}
    content["obstacle"] = [
        {"name": "block", "shape": "sphere", "size_m": [0.1], "position_m": [0, 0, 9]}
    ]
    two = cells.build(tmp_path / "two", content)
    assert [arm.name for arm in two.arms] == ["arm0", "other"]
    assert not np.array_equal(two.model.body("other/").pos, one.model.body("arm1/").pos)
    np.testing.assert_array_equal(two.model.body("arm0/").pos, one.model.body("arm0/").pos)
    cells.build(tmp_path / "three", mixed("slider", "slider"))
    assert written(tmp_path / "three" / "scene") == first


@pytest.mark.parametrize(
    "replacements",
    [
        {"<mujoco": "<mujoc<"},
        {' name="tool"': ' name="other"'},
        {'name="X" axis="1 0 0" range="-0.4 0.4"': 'name="X" type="ball"'},
        {"<worldbody>": '<include file="none.xml"/><worldbody>'},
    ],
    ids=["no XML", "no site", "no such joint", "no such include"],
)
def test_a_refused_file_is_refused_each_time_with_the_same_words(tmp_path, replacements):
    content = own_model(tmp_path, replacements)
    words = []
    for _ in range(3):
        with pytest.raises(InputError) as refused:
            cells.build(tmp_path, content)
        words.append(refused.value.faults)
    assert words[0]
    assert words[0] == words[1] == words[2]
    cells.build(tmp_path, own_model(tmp_path, {}))


def test_what_is_kept_is_bounded(tmp_path):
    for k in range(2 * arm_file.KEPT):
        cells.build(tmp_path, own_model(tmp_path, {"372": str(372 + k)}))
    for kept in (arm_file._read, arm_part._prepared, compose._skeleton):
        assert kept.cache_info().currsize <= arm_file.KEPT
    assert len(pairs._self_extremes) <= pairs._KEPT


def test_self_pairs_do_not_depend_on_what_was_prepared_before(tmp_path):
    """Where the arms stood then, and their homes, leave no trace."""
    content = mixed("pa10", "planar3")
    moved = copy.deepcopy(content)
    moved["arm"][0] |= {"base_position_m": [0.3, -0.1, 0.2], "base_wxyz": [0.6, 0.0, 0.0, 0.8]}
    # The folded arm is so near itself at home that fewer of its pairs stay apart.
    moved["arm"][0]["home_rad"] = [0.0, 1.5, 0.0, 2.39, 0.0, 1.8, 0.0]
    alone = {}
    for name, asked in (("first", content), ("moved", moved)):
        pairs._self_extremes.clear()
        alone[name] = cells.build(tmp_path / name, asked).pairs
    assert alone["first"].omitted != alone["moved"].omitted
    assert len(pairs._self_extremes) == 1
    for name, asked in (("first", content), ("moved", moved)):
        after = cells.build(tmp_path / name, asked).pairs
        assert (after.names, after.omitted) == (alone[name].names, alone[name].omitted)
    assert len(pairs._self_extremes) == 1


def test_what_is_resolved_in_the_preview_holds_in_the_scene(tmp_path):
    asked = scenario.load("give_instrument")
    cell = scene.build(asked, tmp_path)
    assert repr(arm_addresses(cell.model, asked, compose.compose(asked).arms)) == repr(cell.arms)
    assert instrument_addresses(cell.model, asked) == cell.instruments
    preview = compose.preview(compose.compose(asked))
    for field in ("geom_size", "geom_pos", "body_pos", "body_inertia", "jnt_range", "site_pos"):
        np.testing.assert_array_equal(getattr(preview, field), getattr(cell.model, field))


def test_pairs_are_chosen_as_if_every_pose_had_been_looked_at(tmp_path):
    cell = cells.build(tmp_path, mixed("planar3", "pa10"))
    number = {cell.model.geom(g).name: g for g in range(cell.model.ngeom)}
    extremes = partial(plain.extremes, cell.model, cell.arms)
    seen = set()
    for g, h, reason in cell.pairs.omitted:
        within = g.split("/")[0] == h.split("/")[0]
        poses = SAMPLES if within else FEW_SAMPLES
        low, high = extremes(number[g], number[h], poses)
        seen.add(kind := reason.split(":")[0])
        assert (kind == "static") == (high - low < 1e-6)
        assert within or kind == "static"
        if kind == "apart":
            assert low > APART_M
            assert reason == f"apart: never nearer than {low:.3f} m in {SAMPLES} sampled poses"
    assert seen == {"static", "neighbours", "apart"}
    for (g, h), owners in zip(cell.pairs.geoms, cell.pairs.owners, strict=True):
        within = owners[0] == owners[1]
        low, high = extremes(g, h, SAMPLES if within else FEW_SAMPLES)
        assert high - low >= 1e-6
        assert not within or low <= APART_M
