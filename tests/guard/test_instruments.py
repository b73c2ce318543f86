"""Instruments: held against everything but the hand that holds them, or has just let them go."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from workcell.errors import InputError
from workcell.guard.checker import Checker
from workcell.guard.settings import CheckSettings, Exemption, Held
from workcell.guard.shared_memory import CLOSED, NOBODY, Answer, Request

from .cell import ARM, CLEAR_POSE, CRASH_POSE, PERIOD_S, scene_text, settings, write_scene

ROD = """
<body name="rod" pos="0 0 1">
  <freejoint name="rod_free"/>
  <geom name="rod_capsule" type="capsule" size=".01 .05" group="4"/>
  <geom name="rod_rod" type="capsule" size=".008 .05" group="2"/>
</body>
"""
NURSE, SURGEON = 0, 1
RELEASE_TICKS = 100
GIVEN = settings(
    instruments=(Held("rod", rests_on=("table",)),),
    hands=(("nurse/link4", "nurse/tool"), ("surgeon/link4", "surgeon/tool")),
    release_s=RELEASE_TICKS * PERIOD_S,
)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    bodies = ARM.format(a="nurse", x=-0.3) + ARM.format(a="surgeon", x=0.3) + ROD
    return write_scene(tmp_path_factory.mktemp("rod"), scene_text(bodies=bodies))


@pytest.fixture
def checker(scene: Path) -> Checker:
    return Checker(scene, GIVEN)


def at(position_m: tuple[float, float, float]) -> NDArray[np.float64]:
    """(17,) upright arms and the upright rod at a place."""
    return np.concatenate([CLEAR_POSE, position_m, [1.0, 0.0, 0.0, 0.0]])


def on(checker: Checker, geom: str, arms: NDArray[np.float64] = CLEAR_POSE) -> NDArray[np.float64]:
    """(17,) the rod right inside a geom."""
    data = mujoco.MjData(checker.model)
    data.qpos[:10] = arms
    mujoco.mj_kinematics(checker.model, data)
    return np.concatenate([arms, data.geom(geom).xpos, [1.0, 0.0, 0.0, 0.0]])


def ask(
    checker: Checker, qpos: NDArray[np.float64], holder: int, *, tick: int = 0, opened: int = CLOSED
) -> Answer:
    windows = (opened,) * len(checker.settings.exemptions)
    return checker.answer(Request(tick + 1, tick, windows, qpos, (holder,)))


def names(checker: Checker, answer: Answer) -> set[str]:
    return {checker.geometry.pieces[k].name for k in answer.pair}


def test_only_the_hand_that_holds_it_may_touch_it(scene: Path):
    # A checker each: none of them has seen another holder.
    held, lying, elsewhere = (Checker(scene, GIVEN) for _ in range(3))
    qpos = on(held, "nurse/tool_tip")
    assert not ask(held, qpos, NURSE).halt
    for checker, holder in ((lying, NOBODY), (elsewhere, SURGEON)):
        answer = ask(checker, qpos, holder)
        assert answer.halt
        assert "rod_rod" in names(checker, answer)


@pytest.mark.parametrize("geom", ["nurse/link2_bar", "surgeon/tool_tip", "post"])
def test_a_held_instrument_is_a_part_of_its_arm_and_kept_from_the_rest(checker, geom):
    answer = ask(checker, on(checker, geom), NURSE)
    assert answer.halt
    assert names(checker, answer) == {"rod_rod", geom}


def test_it_may_touch_what_it_rests_on_but_no_other_obstacle(checker: Checker):
    assert not ask(checker, at((0.0, 0.0, 0.05)), NOBODY).halt
    assert ask(checker, at((0.0, 0.3, 0.05)), NOBODY).halt  # in the post
    row = [row for row in checker.table.left_out if row.reason == "the instrument lies on it"]
    assert [(r.body_i, r.body_j) for r in row] == [("rod", "table")]


def test_a_hand_that_lets_go_may_touch_it_until_it_has_once_been_clear(checker: Checker):
    touching = on(checker, "nurse/tool_tip")
    clear = at((0.0, 0.0, 0.5))
    assert not ask(checker, touching, NURSE, tick=0).halt
    assert not ask(checker, touching, SURGEON, tick=1).halt
    assert not ask(checker, touching, SURGEON, tick=RELEASE_TICKS).halt
    assert not ask(checker, clear, SURGEON, tick=50).halt
    assert ask(checker, touching, SURGEON, tick=51).halt


@pytest.mark.parametrize(("clear_m", "halts"), [(None, True), (0.05, False)])
def test_how_far_is_clear_may_be_another_distance_than_that_of_a_halt(scene: Path, clear_m, halts):
    """A judge of contacts halts at 0; what has just been let go lies nearer than that to nobody's fault."""
    checker = Checker(scene, replace(GIVEN, d_min_m=0.0, clear_m=clear_m))
    near = beside(checker, "nurse/tool_tip", 0.02)
    assert not ask(checker, near, NURSE).halt
    assert not ask(checker, near, NOBODY, tick=1).halt
    assert ask(checker, on(checker, "nurse/tool_tip"), NOBODY, tick=2).halt is halts


def test_a_hand_that_never_gets_clear_is_let_off_for_a_time_only(checker: Checker):
    touching = on(checker, "nurse/tool_tip")
    ask(checker, touching, NURSE, tick=0)
    assert not ask(checker, touching, SURGEON, tick=1).halt
    assert ask(checker, touching, SURGEON, tick=1 + RELEASE_TICKS).halt


def test_letting_go_lets_nothing_else_touch(checker: Checker):
    ask(checker, on(checker, "nurse/tool_tip"), NURSE, tick=0)
    crash = on(checker, "nurse/tool_tip", CRASH_POSE)
    assert ask(checker, crash, SURGEON, tick=1).halt


def beside(checker: Checker, geom: str, gap_m: float) -> NDArray[np.float64]:
    """(17,) the rod beside the upper end of a tool tip; both radii are 8 mm."""
    x, y, z, *_ = on(checker, geom)[10:]
    return at((x - 0.016 - gap_m, y, z + 0.06))


@pytest.fixture
def exchange(scene: Path) -> Checker:
    window = Exemption(
        "nurse_surgeon", ("nurse/tool", "rod"), ("surgeon/tool", "rod"), 1.0, 0.1, 0.001
    )
    return Checker(scene, replace(GIVEN, exemptions=(window,)))


def test_in_an_exchange_the_other_hand_may_come_near_on_terms(exchange: Checker):
    near, nearer = (beside(exchange, "surgeon/tool_tip", gap) for gap in (0.003, 0.0005))
    assert ask(exchange, near, NURSE, opened=CLOSED).halt
    inside = ask(exchange, near, NURSE, opened=0)
    assert not inside.halt
    assert inside.exempt_distance_m == pytest.approx(0.003, abs=1e-6)
    assert ask(exchange, nearer, NURSE, tick=100, opened=100).exemption_fault == 0
    # Handed over, what touches is the surgeon's own.
    assert not ask(exchange, nearer, SURGEON, tick=101, opened=100).halt


def test_a_hand_that_comes_clear_in_an_exchange_does_not_seem_to_leap(exchange: Checker):
    ask(exchange, on(exchange, "nurse/tool_tip"), NURSE, tick=0, opened=0)
    before = ask(exchange, on(exchange, "nurse/tool_tip"), SURGEON, tick=1, opened=0)
    after = ask(exchange, beside(exchange, "nurse/tool_tip", 0.006), SURGEON, tick=2, opened=0)
    # Let off before, held to the terms after: the distance drops, but nothing has come nearer.
    assert before.exempt_distance_m > 0.4
    assert after.exempt_distance_m == pytest.approx(0.006, abs=1e-6)
    assert not before.halt
    assert not after.halt


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"instruments": (Held("lance"),)}, "instruments.lance: no body"),
        (
            {"instruments": (Held("rod", ("tray",)),)},
            "instruments.rod.rests_on: no geom is named 'tray'",
        ),
        (
            {"hands": (("nurse/tool",), ("surgeon/claw",))},
            "hands: none of surgeon/claw has geometry",
        ),
    ],
)
def test_unknown_names_are_refused(scene: Path, changes, message):
    with pytest.raises(InputError, match=message):
        Checker(scene, replace(GIVEN, **changes))


def test_hands_are_needed_for_instruments_and_settings_survive_the_wire():
    with pytest.raises(InputError, match="hands: 0 are named for 2 arms"):
        settings(instruments=(Held("rod"),))
    assert CheckSettings.from_json(GIVEN.to_json()) == GIVEN
