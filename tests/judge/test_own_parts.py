"""What the judge holds apart within one arm, against the final check's opinion, which shares no code with it."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from tests import cells
from tests.guard.test_pairs import FOLDED, HINGED, WIDE
from workcell.admission import admit
from workcell.judge import ContactWatch
from workcell.judge.own_parts import OwnParts

from .conftest import judged_scene

RANGES = {"J1": "-1 1", "J2": "-1 1", "reach": ".2", "more": ""}


@pytest.mark.parametrize(
    ("parts", "one", "other", "judged"),
    [
        ({}, "beam", "probe", False),
        ({"J2": "-3 3"}, "beam", "probe", True),
        ({"J2": "-3 3"}, "beam", "fork", False),  # in every pose
        ({"J1": "-3 3"}, "mast", "beam", True),
        ({"J1": "-.5 .5", "J2": "2.6 3", "reach": ".39"}, "mast", "probe", True),
    ],
)
def test_neighbours_are_judged_where_their_ranges_let_them_collide(parts, one, other, judged):
    model = mujoco.MjModel.from_xml_string(HINGED.format(**RANGES | parts))
    pair = model.geom(f"nurse/{one}").id, model.geom(f"nurse/{other}").id
    link = {"mast": 0, "beam": 1, "fork": 2, "probe": 2}
    joints = list(range(link[one], link[other]))
    assert OwnParts(model, 0.01).that_can_collide(joints, [pair]) == ([pair] if judged else [])


def test_bodies_that_overlap_only_at_the_zero_pose_are_judged():
    """The zero pose may lie outside the joint ranges; the arm never stands there."""
    model = mujoco.MjModel.from_xml_string(FOLDED.format(**WIDE))
    pair = model.geom("nurse/probe").id, model.geom("nurse/mast").id
    assert not OwnParts(model, 0.01).always_touch([pair])
    narrow = dict.fromkeys(WIDE, "-.01 .01")
    model = mujoco.MjModel.from_xml_string(FOLDED.format(**narrow))
    assert OwnParts(model, 0.01).always_touch([pair])


def test_judge_and_final_check_hold_the_same_neighbours_apart(tmp_path):
    admitted = admit(cells.load(tmp_path, cells.duet()), tmp_path / "scene")
    assert admitted.checker is not None
    pieces = admitted.checker.geometry.pieces
    close = np.argwhere(np.triu(admitted.checker.table.close)).tolist()
    held = {frozenset(pieces[k].name for k in pair) for pair in close}
    scene = judged_scene(admitted.cell, tmp_path / "scene")
    judged = {frozenset(map(scene.name, pair)) for pair in scene.neighbours.tolist()}
    assert judged == held != set()


def test_an_arm_that_folds_back_onto_itself_has_touched(tmp_path):
    cell = cells.build(tmp_path, cells.duet())
    scene = judged_scene(cell, tmp_path / "scene")
    watch = ContactWatch(scene, clear_m=0.01)
    data = mujoco.MjData(cell.model)
    cell.place_home(data)
    qpos = np.array(data.qpos)
    folded = scene.dofs["nurse"][1:]
    for share in np.linspace(0.0, 1.0, 200):
        qpos[folded] = (1.0 - share) * np.array([-0.9, -0.6]) + share * np.array([2.6, 2.6])
        watch.look(float(share), qpos, np.zeros(6))
    assert watch.contact is not None
    assert {name.split("/")[0] for name in watch.contact.pair} == {"nurse"}
    assert watch.smallest_pair is not None
    # What neighbours do is not told as the smallest distance.
    assert set(watch.smallest_pair) != set(watch.contact.pair)
