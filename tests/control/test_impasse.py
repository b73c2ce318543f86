"""A post in the way of an arm that cannot get past: everything is tried in order, nothing is touched."""

from __future__ import annotations

from itertools import groupby

import mujoco
import numpy as np
import pytest

from tests import cells
from workcell.control.controller import Controller, TickRecord
from workcell.control.ladder import ATTEMPT_S, ATTEMPTS, IMPASSE_S

DT = 0.02
STANDOFF_M = 0.02
"""Above d_min: the arm comes to rest before it must be halted."""


@pytest.fixture(scope="module")
def stuck(tmp_path_factory) -> list[TickRecord]:
    """The nurse is to move its tool to the other side of a post."""
    content = cells.duet(standoff_m=STANDOFF_M)
    content["simulation"] |= {"duration_s": 30.0, "period_s": DT}
    content["arm"][0]["base_position_m"] = [1.5, 0.0, 0.0]
    content["arm"][1]["job"] = [{"kind": "move", "waypoints": [{"position_m": [-0.09, 0.60, 0.3]}]}]
    content["obstacle"] = [
        {
            "name": "post",
            "shape": "capsule",
            "size_m": [0.03, 0.2],
            "position_m": [-0.17, 0.64, 0.3],
        }
    ]
    cell = cells.build(tmp_path_factory.mktemp("impasse"), content)
    controller, data = Controller(cell), mujoco.MjData(cell.model)
    cell.place_home(data)
    records = []
    for _ in range(cell.scenario.ticks):
        records.append(controller.step(data.qpos, data.qvel))
        data.qvel[:] = records[-1].command_rad_s
        mujoco.mj_integratePos(cell.model, data.qpos, np.asarray(data.qvel), cell.period_s)
    return records


def test_attempts_come_in_order_each_with_its_time(stuck):
    spans = [
        (a, len(list(rows)) * DT) for a, rows in groupby(r.arms["nurse"].attempt for r in stuck)
    ]
    names = [name for name, _ in spans]
    assert names == ["", *ATTEMPTS, ""]
    for _, lasted_s in spans[1:-1]:
        assert lasted_s == pytest.approx(ATTEMPT_S, abs=2 * DT)


def test_it_stood_for_the_stated_time_before_it_is_called_an_impasse(stuck):
    first = next(k for k, r in enumerate(stuck) if r.arms["nurse"].attempt)
    before = [r.arms["nurse"].scale for r in stuck[first - round(IMPASSE_S / DT) + 2 : first]]
    assert max(before) < 0.03


def test_when_everything_has_been_tried_it_holds(stuck):
    assert {r.arms["nurse"].mode for r in stuck[-50:]} == {"hold"}
    assert {r.arms["nurse"].job for r in stuck[-50:]} == {"move"}


def test_backing_off_goes_back_on_the_path_and_nothing_is_touched(stuck):
    clock = [r.arms["nurse"].path_s for r in stuck if r.arms["nurse"].attempt == "back_off"]
    assert clock[-1] < clock[0] - 0.5
    assert min(r.pair_distance_m.min() for r in stuck) > STANDOFF_M
