"""The machine alone, driven by numbers: when each state is entered and when it is left."""

from __future__ import annotations

from itertools import groupby

import pytest

from workcell.control.recovery import (
    ATTEMPT_S,
    ATTEMPTS,
    DETOUR,
    DETOUR_S,
    IMPASSE_S,
    PAUSED_SHARE,
    PROGRESS_S,
    STANDSTILL_FACTOR,
    YIELD_LINGER_S,
    Recovery,
    RecoveryState,
)

DT = 1 / 64
"""A power of two, so that times add up exactly."""
ALL_ATTEMPTS_S = ATTEMPT_S * len(ATTEMPTS)


def stand(
    machine: Recovery,
    seconds: float,
    *,
    clock_s=1.0,
    moving=True,
    must_yield=False,
    out_of_reach=False,
) -> list[RecoveryState]:
    """A path whose clock stands still."""
    return [
        machine.advance(
            must_yield=must_yield, clock_s=clock_s, moving=moving, out_of_reach=out_of_reach
        )
        for _ in range(round(seconds / DT))
    ]


def creep(machine: Recovery, seconds: float, rate: float) -> list[RecoveryState]:
    """A path whose clock goes at a fraction of the time."""
    return [
        machine.advance(must_yield=False, clock_s=1.0 + k * rate * DT, moving=True)
        for k in range(1, round(seconds / DT) + 1)
    ]


def test_an_arm_under_pressure_gives_way_at_once_and_lingers():
    machine = Recovery(period_s=DT)
    (first,) = stand(machine, DT, must_yield=True)
    assert first.yielding
    after = [state.yielding for state in stand(machine, 1.0)]
    assert sum(after) * DT == pytest.approx(YIELD_LINGER_S, abs=DT)
    assert after == sorted(after, reverse=True), "left once, not on and off"


def test_pressure_that_comes_and_goes_is_one_giving_way():
    """A hand that trembles at 8 Hz must not make the arm start and stop with it."""
    machine = Recovery(period_s=DT)
    yielding = [
        machine.advance(must_yield=k % 8 == 0, clock_s=0.0, moving=True).yielding
        for k in range(256)
    ]
    assert all(yielding)


def test_an_arm_told_not_to_yield_does_not():
    machine = Recovery(period_s=DT, yields=False)
    assert not any(state.yielding for state in stand(machine, 1.0, must_yield=True))


def test_a_standstill_becomes_an_impasse_after_its_time_and_is_tried_in_order():
    machine = Recovery(period_s=DT)
    machine.advance(must_yield=False, clock_s=1.0, moving=True)
    states = stand(machine, IMPASSE_S + ALL_ATTEMPTS_S + 1.0)
    found = next(k for k, state in enumerate(states) if state.impasse)
    assert (found + 1) * DT == pytest.approx(IMPASSE_S)
    assert all(state.impasse for state in states[found:])
    per_attempt = round(ATTEMPT_S / DT)
    tried = [state.attempt for state in states[found:]]
    for k, attempt in enumerate(ATTEMPTS):
        assert set(tried[k * per_attempt : (k + 1) * per_attempt]) == {attempt}
    assert set(tried[len(ATTEMPTS) * per_attempt :]) == {""}, "then it stands and waits"


def test_the_path_pauses_in_the_first_part_of_attempts_that_move_the_elbow_only():
    states = stand(Recovery(period_s=DT), IMPASSE_S + ALL_ATTEMPTS_S)
    for attempt in ATTEMPTS:
        paused = [state.paused for state in states if state.attempt == attempt]
        share = 0.0 if attempt in ("back_off", "re_enter") else PAUSED_SHARE
        assert sum(paused) / len(paused) == pytest.approx(share, abs=0.02)
        assert paused == sorted(paused, reverse=True)


def test_progress_ends_an_impasse_and_creeping_does_not():
    machine = Recovery(period_s=DT)
    assert stand(machine, DT + IMPASSE_S)[-1].impasse
    assert stand(machine, 1.0, clock_s=1.0 + 0.9 * PROGRESS_S)[-1].impasse
    assert not stand(machine, DT, clock_s=1.0 + PROGRESS_S)[-1].impasse
    assert not stand(machine, IMPASSE_S - DT)[-1].impasse, "the time counts from anew"
    assert stand(machine, DT)[-1].impasse


def test_backing_off_is_no_progress():
    """The clock runs back and comes forward again to where it was: nothing is won yet."""
    machine = Recovery(period_s=DT)
    stand(machine, IMPASSE_S, clock_s=2.0)
    stand(machine, 1.0, clock_s=0.5)
    assert stand(machine, DT, clock_s=2.0)[-1].impasse


@pytest.mark.parametrize(
    "state",
    [{"moving": False}, {"must_yield": True}],
    ids=["waiting", "giving way"],
)
def test_what_is_no_impasse(state):
    assert not any(state.impasse for state in stand(Recovery(period_s=DT), 2 * IMPASSE_S, **state))


def test_creeping_is_no_impasse_and_standing_as_good_as_still_is():
    creeping = creep(Recovery(period_s=DT), 2 * IMPASSE_S, 1.01 * STANDSTILL_FACTOR)
    assert not any(state.impasse for state in creeping)
    assert creep(Recovery(period_s=DT), 2 * IMPASSE_S, 0.99 * STANDSTILL_FACTOR)[-1].impasse


def test_progress_makes_the_time_to_an_impasse_count_from_anew():
    machine = Recovery(period_s=DT)
    stand(machine, IMPASSE_S - DT)
    assert not stand(machine, IMPASSE_S - DT, clock_s=1.1)[-1].impasse


def test_giving_way_and_coming_back_over_and_over_is_an_impasse_in_the_end():
    """Only the time that it stands counts, and what was won before is not won again."""
    machine = Recovery(period_s=DT)
    stand(machine, DT)
    for _ in range(8):
        assert not machine.advance(must_yield=False, clock_s=1.0, moving=True).attempt
        stand(machine, 1.0, clock_s=0.8, must_yield=True)
        stand(machine, YIELD_LINGER_S + IMPASSE_S / 8, clock_s=0.8)
    assert stand(machine, DT)[-1].impasse


def test_a_target_out_of_reach_is_no_matter_of_the_elbow():
    machine = Recovery(period_s=DT)
    states = stand(machine, IMPASSE_S + 2 * ATTEMPT_S + 1.0, out_of_reach=True)
    tried = [attempt for attempt, _ in groupby(state.attempt for state in states)]
    assert tried == ["", "back_off", "re_enter", ""]


def test_a_new_path_of_the_same_job_loses_nothing_and_wins_nothing():
    machine = Recovery(period_s=DT)
    stand(machine, IMPASSE_S - DT)
    machine.replanned()
    assert stand(machine, 2 * DT, clock_s=0.0)[-1].impasse
    machine.replanned()
    assert stand(machine, DT, clock_s=0.9 * PROGRESS_S)[-1].impasse
    assert not stand(machine, DT, clock_s=1.1 * PROGRESS_S)[-1].impasse


def test_a_new_path_forgets_what_stood_in_the_way_of_the_old_one():
    machine = Recovery(period_s=DT)
    stand(machine, IMPASSE_S)
    machine.restart()
    assert not stand(machine, DT)[-1].impasse


def test_impasses_are_not_resolved_where_that_is_switched_off():
    states = stand(Recovery(period_s=DT, resolves=False), 2 * IMPASSE_S)
    assert {(state.attempt, state.impasse) for state in states} == {("", False)}


def detour(machine: Recovery, seconds: float, start_s: float, *, on_path: bool, rate: float = 1.0):
    """A path whose clock goes on while the tool is off it, or back at it."""
    return [
        machine.advance(
            must_yield=False, clock_s=start_s + k * rate * DT, moving=True, on_path=on_path
        )
        for k in range(1, round(seconds / DT) + 1)
    ]


def test_a_detour_comes_first_and_lasts_until_the_tool_is_back_at_its_path():
    machine = Recovery(period_s=DT, detours=True)
    assert {s.attempt for s in stand(machine, DETOUR_S)} == {""}
    assert stand(machine, DT)[-1].attempt == DETOUR
    under_way = detour(machine, 4 * ATTEMPT_S, 1.0, on_path=False)
    assert {(s.attempt, s.paused) for s in under_way} == {(DETOUR, False)}
    assert detour(machine, DT, 1.0 + 4 * ATTEMPT_S, on_path=True)[-1].attempt == ""


def test_a_detour_that_wins_nothing_gives_way_to_the_other_attempts():
    machine = Recovery(period_s=DT, detours=True)
    states = stand(machine, DT + DETOUR_S + ATTEMPT_S + ALL_ATTEMPTS_S + 1.0)
    tried = [attempt for attempt, _ in groupby(state.attempt for state in states)]
    assert tried == ["", DETOUR, *ATTEMPTS, ""]
    pressed = Recovery(period_s=DT, detours=True)
    stand(pressed, DT + DETOUR_S)
    assert stand(pressed, ATTEMPT_S + DT, must_yield=True)[-1].attempt == ATTEMPTS[0]
