"""Which pairs are watched, which are not and why, and what an exemption may name."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from workcell.errors import InputError
from workcell.guard.geometry import collect_geometry
from workcell.guard.pairs import PairTable, choose_pairs, joints_between
from workcell.guard.self_pairs import SelfPairs
from workcell.guard.settings import Exemption

from .cell import ARM, ARMS, scene_text


def table_of(
    text: str, exemptions: tuple[Exemption, ...] = ()
) -> tuple[PairTable, dict[str, int], mujoco.MjModel]:
    model = mujoco.MjModel.from_xml_string(text)
    geometry = collect_geometry(model, ARMS)
    index = {piece.name: k for k, piece in enumerate(geometry.pieces)}
    return choose_pairs(model, geometry, ARMS, exemptions), index, model


def exemption(*, i: str = "nurse/tool*", j: str = "surgeon/tool") -> Exemption:
    return Exemption("exchange", (i,), (j,), expiry_s=1.0, max_closing_m_s=0.1, d_min_m=0.0)


def test_every_pair_is_watched_or_left_out_with_a_reason():
    table, index, model = table_of(scene_text())
    assert np.array_equal(table.watched, table.watched.T)
    assert not table.watched.diagonal().any()
    geometry = collect_geometry(model, ARMS)
    said = {(row.body_i, row.body_j) for row in table.left_out}
    for a in geometry.pieces:
        for b in geometry.pieces:
            if a.body == b.body or (table.watched | table.close)[index[a.name], index[b.name]]:
                continue
            one, other = {a.name, a.body_name}, {b.name, b.body_name}
            assert any({i, j} & one and {i, j} & other for i, j in said), (a.name, b.name)
    assert all(row.reason for row in table.left_out)
    # 7 pieces an arm: 49 between the arms less 1 of the bases; 2 x 3 obstacles x 6 moving pieces
    # less the 2 drums over the table; within each arm base-link3/4/tool, drum-link4/tool and the
    # two pieces of link2 with the tool.
    assert np.count_nonzero(table.watched) // 2 == 48 + 36 - 2 + 2 * (3 + 2 + 2)
    assert not (table.watched & table.close).any()


def test_arms_are_held_against_each_other_down_to_the_base():
    table, index, _ = table_of(scene_text())
    assert table.watched[index["nurse/base_plate"], index["surgeon/tool_tip"]]
    assert not table.watched[index["nurse/base_plate"], index["surgeon/base_plate"]]


def test_the_first_link_is_let_off_only_what_its_base_stands_on():
    table, index, _ = table_of(scene_text())
    assert not table.watched[index["nurse/link1_drum"], index["table"]]
    assert table.watched[index["nurse/link1_drum"], index["post"]]
    assert table.watched[index["nurse/link2_hub"], index["table"]]


def test_a_loose_object_is_held_against_the_arms_only():
    loose = "<body name='bowl' pos='0 0 1'><freejoint/><geom name='rim' size='.05'/></body>"
    table, index, _ = table_of(scene_text().replace("<body name", loose + "<body name", 1))
    assert table.watched[index["rim"], index["nurse/tool_tip"]]
    assert table.watched[index["rim"], index["nurse/base_plate"]]
    assert not table.watched[index["rim"], index["table"]]


def test_joints_are_counted_over_the_world():
    _, _, model = table_of(scene_text())
    body = {name: model.body(name).id for name in ("nurse/base", "nurse/tool", "surgeon/link2")}
    assert joints_between(model, body["nurse/base"], body["nurse/tool"]) == 5
    assert joints_between(model, body["nurse/tool"], body["surgeon/link2"]) == 7


FOLDED = """
<mujoco><compiler angle="radian"/><worldbody>
  <body name="nurse/base">
    <geom name="nurse/mast" type="cylinder" size=".03 .2" pos="-.2 0 .2"/>
    <geom name="nurse/post" type="cylinder" size=".03 .1" pos="0 0 .1"/>
    <body name="nurse/link1" pos="0 0 .3">
      <joint name="nurse/J1" axis="0 0 1" range="{J1}"/><geom type="box" size=".1 .01 .01" pos=".1 0 0"/>
      <body name="nurse/link2" pos=".2 0 0" quat="0 0 0 1">
        <joint name="nurse/J2" axis="0 0 1" range="{J2}"/><geom type="box" size=".1 .01 .01" pos=".1 0 0"/>
        <body name="nurse/link3" pos=".2 0 0">
          <joint name="nurse/J3" axis="0 0 1" range="{J3}"/>
          <geom name="nurse/probe" type="capsule" size=".01 .1" fromto="0 0 0 .2 0 0"/>
        </body></body></body></body>
  <body name="surgeon/base" pos="3 0 0"><geom size=".1"/></body>
</worldbody></mujoco>
"""
"""An arm whose probe is in its own mast at the zero pose."""
WIDE = {"J1": "-2.9 2.9", "J2": "0.5 5.7", "J3": "-2.6 2.6"}


def folded(home: tuple[float, ...], **ranges: str) -> tuple[PairTable, int, int]:
    model = mujoco.MjModel.from_xml_string(FOLDED.format(**WIDE | ranges))
    geometry = collect_geometry(model, ARMS)
    index = {piece.name: k for k, piece in enumerate(geometry.pieces)}
    table = choose_pairs(model, geometry, ARMS, home=home)
    return table, index["nurse/probe"], index["nurse/mast"]


def test_what_overlaps_only_at_the_zero_pose_is_watched():
    """The zero pose may lie outside the joint ranges; the arm never stands there."""
    table, probe, mast = folded((0.3, 5.1, 1.2))
    assert table.watched[probe, mast]


def test_what_overlaps_at_home_but_not_everywhere_is_watched_too():
    """It could collide again after it has parted; the start is refused instead."""
    table, probe, mast = folded((0.0, 0.5, -0.5))
    assert table.watched[probe, mast]


def test_what_overlaps_at_home_and_in_every_sampled_pose_is_left_out_by_name():
    narrow = {"J1": "-.01 .01", "J2": "-.01 .01", "J3": "-.01 .01"}
    table, probe, mast = folded((0.0, 0.0, 0.0), **narrow)
    assert not table.watched[probe, mast]
    (row,) = [r for r in table.left_out if {r.body_i, r.body_j} == {"nurse/base", "nurse/link3"}]
    assert "in all of 100 poses within the joint ranges" in row.reason
    assert row.by_name


HINGED = """
<mujoco><compiler angle="radian"/><worldbody>
  <body name="nurse/base">
    <geom name="nurse/mast" type="cylinder" size=".03 .2" pos="-.2 0 .1"/>
    <body name="nurse/link1">
      <joint name="nurse/J1" axis="0 0 1" range="{J1}"/>
      <geom name="nurse/hub" type="cylinder" size=".03 .03"/>
      <geom name="nurse/beam" type="box" size=".07 .01 .01" pos=".12 0 0"/>
      <body name="nurse/link2" pos=".2 0 0">
        <joint name="nurse/J2" axis="0 0 1" range="{J2}"/>
        <geom name="nurse/fork" type="box" size=".02 .02 .02"/>
        <geom name="nurse/probe" type="capsule" size=".01 .1" fromto=".05 0 0 {reach} 0 0"/>
      </body></body></body>
  <body name="surgeon/base" pos="3 0 0"><geom size=".1"/></body>
</worldbody>{more}</mujoco>
"""
"""An arm of two joints: its hub is beside its mast, and its probe can fold back onto the beam before it."""


def hinged(more: str = "", **parts: str) -> tuple[PairTable, dict[str, int]]:
    ranges = {"J1": "-1 1", "J2": "-1 1", "reach": ".2", "more": more}
    model = mujoco.MjModel.from_xml_string(HINGED.format(**ranges | parts))
    geometry = collect_geometry(model, ARMS)
    index = {piece.name.removeprefix("nurse/"): k for k, piece in enumerate(geometry.pieces)}
    return choose_pairs(model, geometry, ARMS), index


@pytest.mark.parametrize(
    ("parts", "one", "other", "held"),
    [
        ({}, "beam", "probe", False),
        ({"J2": "-3 3"}, "beam", "probe", True),  # one joint apart, folded back
        ({"J1": "-3 3"}, "mast", "beam", True),  # one joint apart, turned round
        ({"J1": "-3 3"}, "mast", "hub", False),  # never touching
        ({"J2": "-3 3"}, "beam", "fork", False),  # touching in every pose
        ({"J1": "-.5 .5", "J2": "2.6 3", "reach": ".39"}, "mast", "probe", True),  # two apart
        ({"J1": "-.5 .5", "J2": "2.6 3", "reach": ".3"}, "mast", "probe", False),
    ],
)
def test_neighbours_are_held_apart_where_their_ranges_let_them_collide(parts, one, other, held):
    table, index = hinged(**parts)
    assert table.close[index[one], index[other]] == held
    assert not table.watched[index[one], index[other]]


def test_neighbours_that_the_model_excludes_are_named_and_not_held_apart():
    more = "<contact><exclude body1='nurse/link1' body2='nurse/link2'/></contact>"
    table, index = hinged(more, J2="-3 3")
    assert not table.close[index["beam"], index["probe"]]
    (row,) = [row for row in table.left_out if "contact/exclude" in row.reason]
    assert row.by_name


def test_what_is_left_out_of_neighbours_says_why():
    table, _ = hinged(J2="-3 3")
    reasons = {(row.body_i, row.body_j): row.reason for row in table.left_out}
    assert "thus by design" in reasons["nurse/link1", "nurse/link2"]
    assert "not touching in any of 61 poses" in reasons["nurse/base", "nurse/link1"]


def test_two_arms_of_one_file_are_looked_at_once(monkeypatch):
    calls = []
    seen = SelfPairs._over_grid
    monkeypatch.setattr(
        SelfPairs, "_over_grid", lambda self, *args: calls.append(args) or seen(self, *args)
    )
    table_of(scene_text())
    both = len(calls)
    calls.clear()
    model = mujoco.MjModel.from_xml_string(scene_text(bodies=ARM.format(a="nurse", x=-0.3)))
    choose_pairs(model, collect_geometry(model, ("nurse",)), ("nurse",))
    assert len(calls) == both > 0


def test_an_exclusion_of_the_model_is_honoured_and_said():
    extra = "<contact><exclude body1='surgeon/link4' body2='nurse/link4'/></contact>"
    table, index, _ = table_of(scene_text(extra=extra))
    assert not table.watched[index["nurse/link4_wedge"], index["surgeon/link4_wedge"]]
    assert sum("contact/exclude" in row.reason for row in table.left_out) == 1


def test_an_exemption_lifts_its_own_pairs_only():
    table, index, _ = table_of(scene_text(), (exemption(j="surgeon/link4_wedge"),))
    lifted = np.argwhere(np.triu(table.exempt[0]))
    assert lifted.tolist() == [[index["nurse/tool_tip"], index["surgeon/link4_wedge"]]]


def test_an_exemption_of_something_unknown_is_refused_by_name():
    with pytest.raises(InputError, match=r"exchange\.geoms_i: no geom or body is named 'nuse/.*'"):
        table_of(scene_text(), (exemption(i="nuse/tool"),))


def test_an_exemption_of_pairs_that_are_not_watched_is_refused():
    with pytest.raises(InputError, match="nothing to exempt"):
        table_of(scene_text(), (exemption(i="nurse/link2", j="nurse/link3"),))
