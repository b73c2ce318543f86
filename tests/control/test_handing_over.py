"""An exchange as a run: who owns the instrument from which tick, and where it goes."""

from __future__ import annotations

import numpy as np
import pytest

from tests import cells
from workcell import run as runner
from workcell.trace.table import Trace, load

DT, D_MIN_M = 0.02, 0.01


@pytest.fixture(scope="module")
def given(tmp_path_factory) -> Trace:
    """The nurse gives the surgeon the probe it holds, and goes back."""
    folder = tmp_path_factory.mktemp("give")
    content = cells.duet()
    content["simulation"] |= {"duration_s": 9.0, "period_s": DT}
    content["check"] = {"enabled": False}
    content["instrument"] = [{"name": "probe", "held_by": "nurse", "half_length_m": 0.04}]
    give = {"kind": "exchange", "arm": "surgeon", "instrument": "probe", "direction": "give"}
    content["arm"][1]["job"] = [give | {"dwell_s": 0.2}, {"kind": "retreat"}]
    cell = runner.prepare(cells.load(folder, content), folder / runner.SCENE_FOLDER)
    runner.simulate(cell, folder)
    return load(folder)


def handed_at(trace: Trace) -> int:
    (tick,) = np.flatnonzero(trace["holders"][1:] != trace["holders"][:-1]) + 1
    return int(tick)


def pair(trace: Trace, *names: str) -> int:
    (found,) = [k for k, geoms in enumerate(trace.layout.pairs) if set(geoms) == set(names)]
    return found


def test_it_changes_hands_once_at_the_end_of_the_dwell(given):
    tick = handed_at(given)
    assert (given["holders"][tick - 1], given["holders"][tick]) == ("probe=nurse", "probe=surgeon")
    assert (given["nurse.job"][tick - 1], given["nurse.job"][tick]) == ("dwell", "retreat")
    assert given["nurse.job"][-1] == "done"


def test_the_tools_come_no_nearer_than_the_instrument_may(given):
    distance = given["pair_distance_m"][:, pair(given, "probe_capsule", "surgeon/link3_capsule")]
    assert distance.min() == pytest.approx(D_MIN_M, abs=5e-4)
    assert distance[handed_at(given)] == pytest.approx(D_MIN_M, abs=5e-4)


def test_it_goes_with_the_giver_before_and_with_the_taker_after(given):
    tick, place = handed_at(given), given["qpos"][:, -7:-4]
    moved = np.linalg.norm(place[tick] - place[0])
    assert moved > 0.05
    after = place[tick:] - given["surgeon.tool_position_m"][tick:]
    np.testing.assert_allclose(after, np.broadcast_to(after[0], after.shape), atol=1e-4)
    assert np.linalg.norm(given["nurse.tool_position_m"][-1] - place[-1]) > 0.1, "it let go"


def test_the_takers_hand_does_not_count_from_that_tick_on_and_the_givers_does(given):
    """The instrument is d_min from the hand that holds it now, and that limits nobody."""
    tick, limiting = handed_at(given), given["nurse.limiting_pair"]
    takers = pair(given, "probe_capsule", "surgeon/link3_capsule")
    givers = pair(given, "probe_capsule", "nurse/link3_capsule")
    assert (limiting[:tick] == takers).any()
    assert not (limiting[tick:] == takers).any()
    assert not (limiting[:tick] == givers).any()
    assert given["closest_pair"][tick - 1] == takers
    assert given["closest_pair"][tick + 1] == givers
    opens = (given["pair_rate_m_s"][:, givers] > 0.01) & (np.arange(len(given)) > tick + 1 / DT)
    assert opens.sum() > 50
    assert given["nurse.scale"][opens].min() == 1.0, "leaving is not slowed"
