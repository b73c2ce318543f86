"""A late state is carried on to now by the commands given since, with lost samples in between."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests import cells
from workcell import run as runner
from workcell import scenario as scenario_file
from workcell.control.delay import MOST_LOST, Delay
from workcell.judge import judge_run
from workcell.scene.cell import Cell

LATE = (0, 1, 3, 7)


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> dict[int, Cell]:
    return {
        late: cells.build(
            tmp_path_factory.mktemp("delay"), cells.duet(), f"simulation.latency_ticks={late}"
        )
        for late in LATE
    }


@given(
    st.sampled_from(LATE),
    st.lists(st.integers(0, MOST_LOST), min_size=1, max_size=12),
    st.integers(0, 2**31),
)
def test_joints_that_do_what_they_are_told_are_where_it_says(made, late, gaps, seed):
    """Samples come with gaps of any length up to `MOST_LOST`, the last one standing in for those that are lost."""
    cell, random = made[late], np.random.default_rng(seed)
    nv, period_s = cell.model.nv, cell.period_s
    delay = Delay(cell)
    states = [(random.uniform(-1.0, 1.0, nv), np.zeros(nv))]
    last, told = np.zeros(nv), states[0]
    lost = 0
    for k in range(sum(gaps) + len(gaps) + late):
        if lost == 0:
            told = states[max(0, k - late)]
            lost = gaps.pop() if gaps else 0
        else:
            lost -= 1
        q, dq = delay.now(told[0].copy(), told[1].copy(), last)
        np.testing.assert_allclose(q, states[k][0], atol=1e-12)
        np.testing.assert_allclose(dq, states[k][1], atol=1e-12)
        last = random.uniform(-1.0, 1.0, nv)
        states.append((states[k][0] + period_s * last, last))


def test_what_is_not_late_is_taken_as_it_is(made):
    delay, cell = Delay(made[0]), made[0]
    q, dq = np.arange(cell.model.nq, dtype=float), np.ones(cell.model.nv)
    taken = delay.now(q, dq, np.ones(cell.model.nv))
    assert taken[0] is q
    assert taken[1] is dq


def test_a_sensor_that_has_died_is_carried_on_for_a_while_only(made):
    cell = made[0]
    delay, still, moving = Delay(cell), np.zeros(cell.model.nq), np.full(cell.model.nv, 0.5)
    for _ in range(5 * MOST_LOST):
        q, _ = delay.now(still, np.zeros(cell.model.nv), moving)
    np.testing.assert_allclose(q, MOST_LOST * cell.period_s * 0.5)


@pytest.mark.parametrize("latency_ticks", [0, 3])
def test_the_promise_holds_with_late_and_lost_samples(tmp_path, latency_ticks):
    """Judged by the plant's states. Without being carried on, three ticks of 20 ms cost 8 % of t_min here."""
    overrides = (
        "simulation.plant=kinematic",
        "simulation.period_s=0.02",
        f"simulation.latency_ticks={latency_ticks}",
        "simulation.dropped_fraction=0.05",
        "check.enabled=false",
        "control.task_gain_per_s=5.0",
    )
    scenario = scenario_file.load("planar_crossing", overrides)
    runner.run(scenario, tmp_path / "run")
    verdict = judge_run(tmp_path / "run")
    own_s = verdict.metrics()["smallest_ttc_command_own_s"]
    assert not verdict.contacts
    assert own_s > 0.99 * scenario.control.t_min_s
