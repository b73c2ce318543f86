"""What a person reads while driving: colours by t_min, numbers that can be read, and whole sentences."""

from __future__ import annotations

from types import SimpleNamespace

import mujoco
import pytest

from tests import cells
from workcell.control.controller import Controller
from workcell.live.status import arm_words, pair_words, status, ttc_colour, ttc_words


@pytest.mark.parametrize(
    ("ttc_s", "colour"),
    [(None, "green"), (9.0, "green"), (2.1, "green"), (1.9, "amber"), (1.09, "red"), (0.0, "red")],
)
def test_the_gauge_is_red_where_an_arm_is_held_and_amber_where_it_soon_will_be(ttc_s, colour):
    assert ttc_colour(ttc_s, 1.0) == colour


def test_times_are_numbers_a_person_can_read():
    assert ttc_words(None) == "–"
    assert ttc_words(float("inf")) == "–"
    assert ttc_words(1.234) == "1.23 s"
    assert ttc_words(123.4) == "over 100 s"


@pytest.fixture(scope="module")
def ticked(tmp_path_factory):
    content = cells.duet()
    content["arm"][0]["operator"] = {"kind": "live"}
    cell = cells.build(tmp_path_factory.mktemp("status"), content)
    data = mujoco.MjData(cell.model)
    cell.place_home(data)
    controller = Controller(cell)
    controller.step(data.qpos, data.qvel)
    return cell, controller


def test_pairs_are_told_as_parts_of_arms(ticked):
    cell, _ = ticked
    told = pair_words(cell, 0)
    assert " of the " in told or " – the " in told
    assert "/" not in told
    assert "_" not in told


def test_the_moment_is_told_for_every_arm(ticked):
    cell, controller = ticked
    now = status(cell, controller, out_of_reach=frozenset(), halt="")
    words = {arm.name: (arm.live, arm.words) for arm in now.arms}
    assert words["surgeon"] == (True, "waits for your first move")
    assert words["nurse"][0] is False
    assert now.t_min_s == 1.0
    halted = status(cell, controller, out_of_reach=frozenset({"surgeon"}), halt="late, no answer")
    assert halted.colour == "red"
    assert [arm.colour for arm in halted.arms] == ["red", "red"]


def row(**more):
    usual = {"operator_state": "", "mode": "run", "attempt": "", "scale": 1.0, "job": "move"}
    usual |= {"limiting_pair": None, "tool_error_m": 0.1, "out_of_reach_m": None}
    return SimpleNamespace(**(usual | more))


@pytest.mark.parametrize(
    ("state", "words"),
    [
        ({}, "moves along its path"),
        ({"mode": "scale", "scale": 0.4, "limiting_pair": "other"}, "slows down to 40 %: {} comes"),
        ({"mode": "halt", "scale": 0.0, "limiting_pair": "other"}, "waits: {} comes"),
        ({"mode": "yield", "scale": 0.0, "limiting_pair": "other"}, "gives way: {} comes"),
        ({"mode": "hold"}, "waits: it found no way past"),
        ({"attempt": "back_off"}, "backs off to get past"),
        ({"job": "done", "mode": "hold"}, "has done its jobs"),
        ({"operator_state": "stale"}, "stands: the input has stopped"),
    ],
)
def test_modes_are_told_in_words(ticked, state, words):
    cell, _ = ticked
    between = next(
        k for k, owners in enumerate(cell.pairs.owners) if set(owners) == {"surgeon", "nurse"}
    )
    if state.get("limiting_pair") == "other":
        state = state | {"limiting_pair": between}
    name = cell.pairs.names[between][cell.pairs.owners[between].index("surgeon")]
    other = name.split("/")[-1].removesuffix("_capsule") + " of the surgeon"
    record = SimpleNamespace(arms={"nurse": row(**state)})
    assert arm_words(cell, record, "nurse") == words.format(other)


def test_out_of_reach_and_a_stop_come_first(ticked):
    cell, _ = ticked
    record = SimpleNamespace(arms={"a": row(operator_state="valid"), "b": row()})
    assert arm_words(cell, record, "a", out_of_reach=True) == "cannot reach farther: 10 cm short"
    assert arm_words(cell, record, "b", halt="late") == "is stopped by the final check"
