"""The check as the controller uses it: verdicts, exemptions, lock-step and free-run."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
import pytest

from workcell.errors import InputError
from workcell.guard import CheckSettings, CheckState, Exemption, FinalCheck
from workcell.guard.checker import Checker
from workcell.guard.shared_memory import CLOSED, Request

from .cell import (
    ARM,
    CLEAR_POSE,
    CRASH_POSE,
    PERIOD_S,
    random_pose,
    scene_text,
    settings,
    write_scene,
)

EXCHANGE = Exemption(
    name="exchange",
    geoms_i=("nurse/tool*",),
    geoms_j=("surgeon/tool*",),
    expiry_s=0.1,
    max_closing_m_s=0.1,
    d_min_m=-0.002,
)
EXPIRY_TICKS = round(EXCHANGE.expiry_s / PERIOD_S)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_scene(tmp_path_factory.mktemp("scene"))


@pytest.fixture(scope="module")
def check(scene: Path) -> Iterator[FinalCheck]:
    with FinalCheck(scene, settings(exemptions=(EXCHANGE,))) as check:
        assert check.start().state == CheckState.CLEAR
        yield check


def test_clear_and_halt_name_distance_pair_and_tick(check: FinalCheck):
    verdict = check.check(10, CLEAR_POSE)
    assert verdict.state == CheckState.CLEAR
    assert not verdict.must_stop
    assert (verdict.tick, verdict.age_ticks) == (10, 0)
    verdict = check.check(11, CRASH_POSE)
    assert verdict.state == CheckState.HALT
    assert verdict.must_stop
    assert verdict.pair is not None
    assert verdict.distance_m is not None
    assert {name.split("/")[0] for name in verdict.pair} == {"nurse", "surgeon"}
    assert verdict.distance_m < 0.005
    assert "d_min" in verdict.reason


def test_halt_begins_exactly_at_d_min(check: FinalCheck, scene: Path):
    search = Checker(scene, settings())
    near = far = None
    for share in np.linspace(0.0, 1.0, 60):
        qpos = CLEAR_POSE + share * (CRASH_POSE - CLEAR_POSE)
        distance_m = search.answer(Request(1, 0, (), qpos)).distance_m
        verdict = check.check(int(share * 1e4), qpos)
        assert verdict.distance_m == pytest.approx(distance_m, abs=1e-6)
        assert (verdict.state == CheckState.HALT) == (distance_m <= 0.005)
        near, far = near or distance_m <= 0.005, far or distance_m > 0.005
    assert near
    assert far


def test_lock_step_asks_on_its_ticks_and_ages_between(scene: Path):
    with FinalCheck(scene, settings(every_ticks=5)) as check:
        check.start()
        seen = [check.check(tick, CLEAR_POSE) for tick in range(11)]
    assert [v.tick for v in seen] == [0] * 5 + [5] * 5 + [10]
    assert [v.age_ticks for v in seen] == [0, 1, 2, 3, 4, 0, 1, 2, 3, 4, 0]
    assert [v.sequence for v in seen] == [1] * 5 + [2] * 5 + [3]


def test_lock_step_runs_are_the_same_to_the_last_bit(scene: Path):
    def run() -> list[object]:
        rng = np.random.default_rng(2)
        with FinalCheck(scene, settings(every_ticks=2)) as check:
            check.start()
            return [check.check(tick, random_pose(rng)) for tick in range(40)]

    assert run() == run()


def test_free_run_answers_in_time_and_with_age(scene: Path):
    with FinalCheck(scene, settings(deadline_s=1.0)) as check:
        check.start()
        ages = []
        for tick in range(200):
            assert check.post(tick, CLEAR_POSE) is None
            verdict = check.poll(tick)
            assert verdict.state == CheckState.CLEAR, verdict
            ages.append(verdict.age_ticks)
            time.sleep(0.0005)
        latency = check.latency
    assert ages[0] == 0, "the first answer is waited for"
    assert latency.answers > 20
    assert latency.compute.median_s is not None
    assert latency.round_trip.worst_s is not None
    assert latency.compute.median_s < latency.round_trip.worst_s


def test_an_answer_that_is_too_old_is_stale(scene: Path):
    with FinalCheck(scene, settings(max_age_ticks=10, deadline_s=1.0)) as check:
        check.start()
        check.post(0, CLEAR_POSE)
        assert check.poll(10).state == CheckState.CLEAR
        verdict = check.poll(11)
    assert verdict.state == CheckState.STALE
    assert verdict.must_stop
    assert verdict.reason == "the newest answer is 11 ticks old, 10 are allowed"


@pytest.mark.parametrize(
    ("qpos", "reason"),
    [
        (np.zeros(3), r"shape \(3,\), the scene needs \(10,\)"),
        (np.where(np.arange(10) == 4, np.nan, 0.0), r"qpos\[4\] is not finite"),
    ],
)
def test_a_configuration_that_cannot_be_checked_stops(check: FinalCheck, qpos, reason):
    verdict = check.check(1, qpos)
    assert verdict.state == CheckState.NONSENSE
    with pytest.raises(AssertionError, match=reason):
        raise AssertionError(verdict.reason)


def tools_at(gap_m: float) -> np.ndarray:
    """Arms leaning towards each other so that the tool tips, and only they, are so far apart."""
    model = mujoco.MjModel.from_xml_string(scene_text())
    data = mujoco.MjData(model)
    tips = [model.geom(f"{arm}/tool_tip").id for arm in ("nurse", "surgeon")]

    def gap(lean: float) -> float:
        data.qpos[:] = qpos_at(lean)
        mujoco.mj_kinematics(model, data)
        return mujoco.mj_geomDistance(model, data, *tips, 1.0, None)

    low, high = -0.3, 0.1
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if gap(middle) > gap_m else (low, middle)
    return qpos_at(low)


def qpos_at(lean: float) -> np.ndarray:
    """The forearms level, the upper arms leaning by so many rad."""
    qpos = np.zeros(10)
    qpos[[1, 6]] = lean - 0.5, 0.5 - lean
    qpos[[2, 7]] = np.pi / 2 - qpos[1], -np.pi / 2 - qpos[6]
    # The tips are off their wrist axes; half a turn of one brings them face to face.
    qpos[9] = np.pi
    return qpos


def test_an_exempt_pair_may_meet_inside_its_window_only(check: FinalCheck):
    near = tools_at(0.001)
    closed = check.check(100, near)
    assert closed.state == CheckState.HALT
    assert closed.pair == ("nurse/tool_tip", "surgeon/tool_tip")

    check.open_exemption("exchange", 101)
    inside = check.check(101, near)
    assert inside.state == CheckState.CLEAR, inside
    assert inside.exempt_distance_m == pytest.approx(0.001, abs=1e-4)
    assert inside.distance_m is not None
    assert inside.distance_m > 0.005

    check.close_exemption("exchange")
    assert check.check(102, near).state == CheckState.HALT


def test_an_exemption_that_is_not_closed_expires(check: FinalCheck):
    near = tools_at(0.001)
    check.open_exemption("exchange", 200)
    last = 200 + EXPIRY_TICKS - 1
    assert check.check(last, near).state == CheckState.CLEAR
    assert check.exemption_state("exchange", last) == "open"
    verdict = check.check(last + 1, near)
    assert verdict.state == CheckState.HALT
    assert "expired: exchange" in verdict.reason
    assert check.exemption_state("exchange", last + 1) == "expired"
    check.close_exemption("exchange")
    assert check.exemption_state("exchange", last + 1) == "closed"


def test_the_other_pairs_stay_watched_inside_a_window(check: FinalCheck):
    check.open_exemption("exchange", 300)
    verdict = check.check(300, CRASH_POSE)
    check.close_exemption("exchange")
    assert verdict.state == CheckState.HALT
    assert verdict.pair != ("nurse/tool_tip", "surgeon/tool_tip")


def test_an_exempt_pair_has_a_smaller_distance_and_a_speed_cap_of_its_own(check: FinalCheck):
    check.open_exemption("exchange", 400)
    try:
        # 0.1 mm a tick is 0.05 m/s, half the cap; 0.4 mm a tick is twice the cap.
        assert check.check(400, tools_at(0.0020)).state == CheckState.CLEAR
        assert check.check(401, tools_at(0.0019)).state == CheckState.CLEAR
        fast = check.check(402, tools_at(0.0015))
        assert fast.state == CheckState.HALT
        assert fast.pair == ("nurse/tool_tip", "surgeon/tool_tip")
        assert "exemption 'exchange'" in fast.reason
        # Opening fast is no fault; pressing deeper than -2 mm is.
        assert check.check(403, tools_at(0.0100)).state == CheckState.CLEAR
    finally:
        check.close_exemption("exchange")
    check.check(404, CLEAR_POSE)
    check.open_exemption("exchange", 405)
    deep = check.check(405, tools_at(-0.003))
    check.close_exemption("exchange")
    assert deep.state == CheckState.HALT
    assert deep.exempt_distance_m is not None
    assert deep.exempt_distance_m <= EXCHANGE.d_min_m


def test_the_checker_itself_ends_a_window_that_its_parent_keeps_open(scene: Path):
    checker = Checker(scene, settings(exemptions=(EXCHANGE,)))
    near = tools_at(0.001)
    assert not checker.answer(Request(1, EXPIRY_TICKS - 1, (0,), near)).halt
    assert checker.answer(Request(2, EXPIRY_TICKS, (0,), near)).halt
    # A window from the future is no window.
    assert checker.answer(Request(3, 5, (6,), near)).halt
    assert checker.answer(Request(4, 5, (CLOSED,), near)).halt


def test_an_unknown_exemption_is_refused_by_name(check: FinalCheck):
    with pytest.raises(InputError, match="'xchange' is unknown; declared: exchange"):
        check.open_exemption("xchange", 0)


def test_an_arm_without_geometry_is_never_clear(tmp_path: Path):
    bare = "<body name='nurse/link'><joint/><geom type='capsule' size='.02 .1' group='4'/></body>"
    scene = write_scene(tmp_path, scene_text(bodies=bare + ARM.format(a="surgeon", x=0.3)))
    with FinalCheck(scene, settings()) as check:
        started = check.start()
        assert started.state == CheckState.NO_GEOMETRY
        assert check.missing == ("nurse/link", "nurse")
        verdict = check.check(0, np.zeros(6))
    assert verdict.state == CheckState.NO_GEOMETRY
    assert verdict.must_stop
    assert verdict.reason == "no high-resolution geometry for nurse/link, nurse"
    assert verdict.distance_m is not None, "what can be checked is checked"


def test_switched_off_it_says_so_and_starts_nothing(scene: Path):
    with FinalCheck(scene, settings(enabled=False)) as check:
        for verdict in (check.start(), check.check(0, CRASH_POSE), check.poll(0)):
            assert verdict.state == CheckState.OFF
            assert not verdict.must_stop
        assert check.pid is None


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ({"d_min_m": float("nan")}, "d_min_m: nan"),
        ({"d_min_m": 0.6}, r"below ceiling_m \(0.5\)"),
        ({"every_ticks": 0}, "every_ticks: 0"),
        ({"deadline_s": 0.0}, "deadline_s: 0.0"),
        ({"arms": ()}, "at least one arm"),
        ({"exemptions": (EXCHANGE, EXCHANGE)}, "'exchange' is used more than once"),
        (
            {"exemptions": (Exemption("e", (), ("a",), 0.0, 0.1, 0.0),)},
            r"(?s)e\.expiry_s: 0\.0.*e\.geoms_i: \(\)",
        ),
    ],
)
def test_impossible_settings_are_refused_by_name(changes: dict, fault: str):
    with pytest.raises(InputError, match=fault):
        settings(**changes)


def test_settings_survive_the_way_to_the_checker():
    given = settings(exemptions=(EXCHANGE,))
    assert CheckSettings.from_json(given.to_json()) == given
