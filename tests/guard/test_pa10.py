"""The check on the arms it is for: two PA10 over a table, in all their housings.

The benchmarks print what docs/final_check.md states; run them with `--benchmark-only`.
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from workcell.guard import CheckSettings, CheckState, FinalCheck
from workcell.guard.checker import Checker
from workcell.guard.shared_memory import Request

from .coal_shapes import shape_of, smallest_distance_m

ARM_XML = Path(__file__).parents[2] / "mjcf" / "pa10" / "pa10.xml"
ARMS = ("surgeon", "nurse")
ROOM = """
<mujoco><worldbody>
  <geom name="floor" type="plane" size="2 2 .1" pos="0 0 -.7"/>
  <geom name="table" type="box" size=".8 .8 .02" pos="0 0 -.02"/>
  <geom name="patient" type="capsule" size=".1 .3" pos="0 .45 .12" euler="0 90 0"/>
</worldbody></mujoco>
"""
SETTINGS = CheckSettings(arms=ARMS, d_min_m=0.005, period_s=0.002, every_ticks=1)
# Both sides stop iterating on curved shapes at 1e-6 m or below; twice that is allowed.
AGREEMENT_M = 2e-6


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    spec = mujoco.MjSpec.from_string(ROOM)
    for arm, x_m in zip(ARMS, (-0.5, 0.5), strict=True):
        frame = spec.worldbody.add_frame(pos=[x_m, 0.0, 0.0])
        body = mujoco.MjSpec.from_file(str(ARM_XML)).worldbody.first_body()
        frame.attach_body(body, f"{arm}/", "")
    spec.compile()
    path = tmp_path_factory.mktemp("pa10") / "scene.xml"
    path.write_text(spec.to_xml())
    return path


@pytest.fixture(scope="module")
def checker(scene: Path) -> Checker:
    return Checker(scene, SETTINGS)


def leaning_pose(rng: np.random.Generator) -> NDArray[np.float64]:
    """The arms, a metre apart, lean towards each other; every joint is somewhere."""
    qpos = rng.uniform(-1.2, 1.2, 14)
    qpos[[0, 7]] *= 0.3
    qpos[1] = rng.uniform(0.2, 1.2)
    qpos[8] = rng.uniform(-1.2, -0.2)
    return qpos


def approach(checker: Checker) -> NDArray[np.float64]:
    """(1000, 14) a slow motion from one near pose to another, 2 s at 2 ms."""
    rng = np.random.default_rng(1)
    ends: list[NDArray[np.float64]] = []
    while len(ends) < 2:
        qpos = leaning_pose(rng)
        if 0.02 < checker.answer(Request(1, 0, (), qpos)).distance_m < 0.08:
            ends.append(qpos)
    return np.linspace(ends[0], ends[1], 1000)


def test_every_moving_body_has_geometry_and_upright_arms_are_clear(checker: Checker):
    assert checker.geometry.missing == ()
    covered = {piece.body for piece in checker.geometry.pieces}
    model = checker.model
    for joint in range(model.njnt):
        assert int(model.jnt_bodyid[joint]) in covered, model.joint(joint).name
    answer = checker.answer(Request(1, 0, (), np.zeros(14)))
    assert not answer.halt
    assert answer.distance_m > 0.02
    # No far pair of one arm overlaps by design, so nothing had to be left out for that.
    assert not [row for row in checker.table.left_out if "overlapping at home" in row.reason]


def test_neighbours_that_could_collide_are_held_apart(checker: Checker):
    """At the ends of their ranges the elbow's fork meets the upper link, and the wrist's the fingers."""
    pieces = checker.geometry.pieces
    close = {
        tuple(sorted(pieces[k].name.removeprefix("nurse/") for k in pair))
        for pair in np.argwhere(np.triu(checker.table.close))
        if pieces[pair[0]].owner == "nurse"
    }
    assert close == {
        ("link3_yoke_lower", "link4_waist"),
        ("link3_yoke_upper", "link4_waist"),
        ("link5_yoke", "tool_finger_back"),
        ("link5_yoke", "tool_finger_front"),
    }
    grazing = [row for row in checker.table.left_out if "grazing" in row.reason]
    assert {row.body_i.split("/")[1] for row in grazing} == {"link5_yoke"}
    elbow = checker.model.joint("nurse/E1")
    for share, halt in ((0.9, False), (1.0, True)):
        qpos = np.zeros(14)
        qpos[elbow.qposadr[0]] = share * elbow.range[1]
        answer = checker.answer(Request(1, 0, (), qpos))
        assert answer.halt == halt, answer
        # While it is far enough, it is not what is told as the smallest distance.
        assert halt or answer.distance_m > 0.02


def test_coal_agrees_on_the_housings(checker: Checker):
    model, pieces = checker.model, checker.geometry.pieces
    floor = [k for k, piece in enumerate(pieces) if piece.name == "floor"]
    mask = np.triu(checker.table.watched)
    mask[floor, :] = mask[:, floor] = False
    shapes = {p.geom: shape_of(model, p.geom) for p in pieces if p.name != "floor"}
    pairs = [(pieces[i].geom, pieces[j].geom) for i, j in np.argwhere(mask).tolist()]
    data = mujoco.MjData(model)
    rng = np.random.default_rng(4)
    compared = 0
    for _ in range(30):
        data.qpos[:] = leaning_pose(rng)
        mujoco.mj_kinematics(model, data)
        found_m = checker.answer(Request(1, 0, (), np.array(data.qpos))).distance_m
        expected_m = smallest_distance_m(data, shapes, pairs)
        if expected_m > 0.0:
            assert found_m == pytest.approx(expected_m, abs=AGREEMENT_M)
            compared += 1
        else:
            # How deep a contact is, is a matter of definition; that it is one, is not.
            assert found_m < AGREEMENT_M
    assert compared >= 10


@pytest.mark.benchmark(group="final check")
def test_bench_check_in_motion(benchmark, checker: Checker):
    path = approach(checker)
    ticks = iter(range(10**9))

    def one() -> None:
        tick = next(ticks)
        checker.answer(Request(tick + 1, tick, (), path[tick % len(path)]))

    benchmark.pedantic(one, rounds=3000)


@pytest.mark.benchmark(group="final check")
def test_bench_check_of_unrelated_poses(benchmark, checker: Checker):
    rng = np.random.default_rng(8)
    poses = [leaning_pose(rng) for _ in range(1000)]
    ticks = iter(range(10**9))

    def one() -> None:
        tick = next(ticks)
        checker.answer(Request(tick + 1, tick, (), poses[tick % len(poses)]))

    benchmark.pedantic(one, rounds=3000)


@pytest.mark.benchmark(group="final check")
def test_bench_lock_step(benchmark, checker: Checker, scene: Path):
    path = approach(checker)
    with FinalCheck(scene, SETTINGS) as check:
        assert check.start().state == CheckState.CLEAR
        ticks = iter(range(10**9))

        def one() -> None:
            tick = next(ticks)
            check.check(tick, path[tick % len(path)])

        benchmark.pedantic(one, rounds=3000)
        latency = check.latency
    print("\nround trip", latency.round_trip)
    print("compute", latency.compute)
    print("handover", latency.handover)
