"""Who closed the gap: shares of the closing speed against Jacobians, causes against staged contacts."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from tests import cells
from workcell import run as runner
from workcell.scene.cell import Cell
from workcell.scene.compose import SCENE_FILE
from workcell.study.contact import FAR_LOOK_S, FAR_M, LOOK_S, ContactJudge


@dataclass(frozen=True)
class Stage:
    """Two planar arms whose outer links are a little apart."""

    cell: Cell
    folder: Path
    qpos: np.ndarray

    def judge(self) -> ContactJudge:
        return ContactJudge(self.cell, self.folder / SCENE_FILE, runner.check_settings(self.cell))

    def dofs(self, arm: str) -> np.ndarray:
        return next(a.dofs for a in self.cell.arms if a.name == arm)


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Stage:
    folder = tmp_path_factory.mktemp("stage")
    cell = cells.build(folder, cells.duet())
    data = mujoco.MjData(cell.model)
    cell.place_home(data)
    return Stage(cell, folder / "scene", np.array(data.qpos))


def turned(stage: Stage, angle: float) -> np.ndarray:
    """The home configuration with the nurse turned about its base towards the surgeon."""
    qpos = stage.qpos.copy()
    qpos[stage.dofs("nurse")[0]] -= angle
    return qpos


@pytest.fixture(scope="module")
def touching(stage: Stage) -> np.ndarray:
    """The first of the nurse's steps towards the surgeon at which the judge sees a touch."""
    judge = stage.judge()
    for angle in np.linspace(0.0, 1.5, 600):
        judge.judge(0, turned(stage, angle), np.zeros(6), [])
        if judge.contact is not None:
            return turned(stage, angle)
    raise AssertionError("the arms never touch")


def fresh(judge: ContactJudge) -> ContactJudge:
    """The same judge with nothing seen yet, without compiling the scene again."""
    judge.smallest_m, judge.smallest_pair, judge.contact = np.inf, None, None
    return judge


def towards(stage: Stage, qpos: np.ndarray, surgeon: float = 0.0, nurse: float = 0.0) -> np.ndarray:
    """Velocities of the arms' first joints, of the given size, positive where they close the gap, rad/s."""
    judge, qvel = stage.judge(), np.zeros(6)
    judge.judge(0, qpos, qvel, [])
    assert judge.smallest_pair is not None
    names = [piece.name for piece in judge._checker.geometry.pieces]
    pair = (names.index(judge.smallest_pair[0]), names.index(judge.smallest_pair[1]))
    for arm, size in (("surgeon", surgeon), ("nurse", nurse)):
        joint = np.asarray(stage.dofs(arm)[:1])
        qvel[joint] = size * np.sign(judge.closing_m_s(pair, qpos, np.ones(6), joint))
    return qvel


def test_shares_of_the_closing_speed_are_those_of_the_jacobians(stage: Stage):
    judge = stage.judge()
    qpos, qvel = turned(stage, 0.3), np.array([0.3, -0.2, 0.4, -0.1, 0.25, -0.3])
    judge.judge(0, qpos, qvel, [])
    assert judge.smallest_pair is not None
    assert judge.contact is None
    model = stage.cell.model
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    names = [piece.name for piece in judge._checker.geometry.pieces]
    i, j = (model.geom(name).id for name in judge.smallest_pair)
    ends = np.zeros(6)
    distance = mujoco.mj_geomDistance(model, data, i, j, 10.0, ends)
    normal = (ends[:3] - ends[3:]) / distance
    rows = []
    for geom, point in ((i, ends[:3]), (j, ends[3:])):
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, jacobian, None, point, model.geom_bodyid[geom])
        rows.append(jacobian)
    closing = -normal @ (rows[0] - rows[1])
    pair = (names.index(judge.smallest_pair[0]), names.index(judge.smallest_pair[1]))
    for arm in ("surgeon", "nurse"):
        dofs = stage.dofs(arm)
        share = judge.closing_m_s(pair, qpos, qvel, np.asarray(dofs))
        assert share == pytest.approx(closing[dofs] @ qvel[dofs], abs=2e-3)


@pytest.mark.parametrize(
    ("surgeon", "nurse", "cause"),
    [
        (0.0, 0.2, "support"),
        (0.2, 0.0, "priority"),
        (0.2, 0.2, "both"),
        (0.2, -0.2, "priority"),
        (-0.2, 0.2, "support"),
        (0.0, 0.0, "none"),
        (-0.2, -0.2, "none"),
    ],
)
def test_the_cause_is_whose_motion_closes_the_gap(
    stage: Stage, touching: np.ndarray, surgeon: float, nurse: float, cause: str
):
    judge = stage.judge()
    judge.judge(0, touching, towards(stage, touching, surgeon, nurse), [])
    assert judge.contact is not None
    assert judge.contact.cause == cause


def test_only_the_first_contact_counts_and_near_misses_do_not(stage: Stage, touching: np.ndarray):
    judge, near = stage.judge(), touching + (stage.qpos - touching) / 10.0
    judge.judge(0, near, towards(stage, near, nurse=0.1), [])
    apart_m = judge.smallest_support_m
    assert judge.contact is None
    assert np.isfinite(apart_m)
    judge.judge(5, touching, towards(stage, touching, surgeon=0.1), [])
    judge.judge(10, touching, towards(stage, touching, nurse=0.1), [])
    assert judge.contact is not None
    assert judge.contact.time_s == pytest.approx(5 * stage.cell.period_s)
    assert judge.contact.cause == "priority"


def test_a_meeting_allows_nearness_but_no_touch(stage: Stage):
    """While two tools meet they are left out of the smallest distance, and a touch of theirs still counts."""
    rng, window = np.random.default_rng(0), ["nurse_surgeon"]
    tools = ("surgeon/link3_probe", "nurse/link3_probe")
    near, touch, plain = stage.judge(), stage.judge(), stage.judge()
    while touch.contact is None or near.smallest_m == np.inf:
        qpos = stage.qpos + rng.uniform(-0.8, 0.8, 6)
        plain = fresh(plain)
        plain.judge(0, qpos, np.zeros(6), [])
        if plain.smallest_pair == tools:
            meeting = near if 0.0 < plain.smallest_m < 0.02 else touch
            meeting.judge(0, qpos, np.zeros(6), window)
            if meeting is near:
                assert near.contact is None
                assert near.smallest_m > plain.smallest_m
    assert touch.contact.pair == tools


def test_looks_are_rare_where_nothing_is_near_and_every_ten_milliseconds_where_something_is(
    stage: Stage, touching: np.ndarray, monkeypatch: pytest.MonkeyPatch
):
    """Nothing slower than 2.5 m/s may come from afar to a touch between two looks."""
    judge, ticks = stage.judge(), []
    near_m = {"value": 0.2}
    monkeypatch.setattr(judge, "judge", lambda tick, *_: ticks.append(tick) or near_m["value"])
    controller = SimpleNamespace(windows=[], grasps=SimpleNamespace(holders={}))
    data = mujoco.MjData(stage.cell.model)
    for tick in range(40):
        near_m["value"] = 0.2 if tick < 20 else 0.05
        judge.look(tick, data, controller)  # type: ignore[arg-type]
    period_s = stage.cell.period_s
    gaps_s = period_s * np.diff(ticks)
    far = np.array(ticks[:-1]) < 20
    assert gaps_s[far].max() <= FAR_LOOK_S + period_s / 2
    assert gaps_s[far].min() > LOOK_S + period_s
    assert gaps_s[~far].max() <= LOOK_S + period_s / 2
    assert FAR_M / FAR_LOOK_S >= 2.5


def test_nearer_than_d_min_is_told_though_nothing_touched(stage: Stage, touching: np.ndarray):
    judge = stage.judge()
    judge.judge(0, stage.qpos, np.zeros(6), [])
    assert not judge.below_d_min
    for share in np.linspace(1.0, 0.0, 200):
        judge.judge(0, touching + share * (stage.qpos - touching), np.zeros(6), [])
        if judge.below_d_min:
            break
    assert judge.below_d_min
    assert judge.contact is None
    assert 0.0 < judge.smallest_m <= stage.cell.scenario.control.d_min_m
