"""An answer that contradicts itself is nonsense, whatever it says."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from workcell.guard import CheckState, Exemption, Verdict
from workcell.guard.judge import judge
from workcell.guard.shared_memory import Answer

from .cell import settings

PIECES = ("nurse/a", "surgeon/b", "table")
EXCHANGE = Exemption("exchange", ("nurse/a",), ("surgeon/b",), 1.0, 0.1, 0.0)
CLEAR = Answer(5, 50, False, 0.1, (0, 1), math.inf, (-1, -1), -1, 3e-4)
HALT = replace(CLEAR, halt=True, distance_m=0.005)


def judged(answer: Answer, *, missing: tuple[str, ...] = ()) -> Verdict:
    given = settings(exemptions=(EXCHANGE,))
    return judge(answer, given, pieces=PIECES, missing=missing, expired=(), tick=53)


def test_a_sound_answer_is_passed_on():
    verdict = judged(CLEAR)
    assert verdict.state == CheckState.CLEAR
    assert (verdict.sequence, verdict.tick, verdict.age_ticks) == (5, 50, 3)
    assert verdict.pair == ("nurse/a", "surgeon/b")
    assert verdict.distance_m == 0.1
    assert verdict.exempt_distance_m is None
    assert judged(HALT).state == CheckState.HALT


def test_at_the_ceiling_there_is_no_pair():
    verdict = judged(replace(CLEAR, distance_m=0.5, pair=(-1, -1)))
    assert verdict.state == CheckState.CLEAR
    assert verdict.pair is None


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"distance_m": math.nan}, "distance is nan"),
        ({"distance_m": -math.inf}, "distance is -inf"),
        ({"distance_m": 0.7}, "distance is 0.7"),
        ({"exempt_distance_m": math.nan}, "exempt distance is not a number"),
        ({"pair": (0, 3)}, r"names the pair (0, 3) of 3 pieces"),
        ({"pair": (1, 0)}, r"names the pair (1, 0)"),
        ({"pair": (-1, -1)}, "names no pair at 0.1 m"),
        ({"exempt_pair": (-2, 0)}, "names the pair (-2, 0)"),
        ({"exemption_fault": 1}, "names exemption 1"),
        ({"distance_m": 0.004}, "says clear at 0.004 m"),
        ({"halt": True}, "says halt at 0.1 m"),
        ({"exemption_fault": 0}, "says clear"),
    ],
)
def test_contradictions_are_named_and_nothing_of_them_is_used(changes: dict, reason: str):
    verdict = judged(replace(CLEAR, **changes))
    assert verdict.state == CheckState.NONSENSE
    assert verdict.must_stop
    assert reason in verdict.reason
    assert verdict.distance_m is None
    assert verdict.pair is None


def test_a_broken_exemption_halts_and_names_the_exempt_pair():
    broken = replace(
        CLEAR,
        halt=True,
        exemption_fault=0,
        exempt_pair=(0, 1),
        exempt_distance_m=-0.01,
        pair=(0, 2),
    )
    verdict = judged(broken)
    assert verdict.state == CheckState.HALT
    assert "'exchange'" in verdict.reason
    assert verdict.pair == ("nurse/a", "surgeon/b")


def test_missing_geometry_turns_clear_into_no_geometry_but_hides_no_halt():
    assert judged(CLEAR, missing=("nurse/hand",)).state == CheckState.NO_GEOMETRY
    assert judged(HALT, missing=("nurse/hand",)).state == CheckState.HALT
