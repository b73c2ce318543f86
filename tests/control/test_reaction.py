"""What delay asks of the task's gain and of t_min, now, later in the run and live."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests import cells
from workcell import scenario
from workcell.admission import admit
from workcell.control import reaction
from workcell.errors import InputError
from workcell.scene import cell as scene


def left_of_an_error(gain_per_s: float, latency_ticks: int, period_s: float) -> float:
    """What a long time leaves of an error of 1 that is corrected by what was measured so many ticks ago."""
    error = [1.0] * (latency_ticks + 1)
    for _ in range(400 * (latency_ticks + 1)):
        error.append(error[-1] - gain_per_s * period_s * error[-1 - latency_ticks])
    return float(np.abs(error[-2 * latency_ticks - 2 :]).max())


@given(st.integers(0, 40), st.sampled_from([0.002, 0.01, 0.02]))
def test_the_largest_gain_has_a_margin_of_two(latency_ticks, period_s):
    simulation = scenario.Simulation(period_s=period_s, latency_ticks=latency_ticks)
    largest = reaction.largest_gain_per_s(simulation)
    assert left_of_an_error(largest, latency_ticks, period_s) < 1e-3
    assert left_of_an_error(1.95 * largest, latency_ticks, period_s) < 1.0
    assert left_of_an_error(2.05 * largest, latency_ticks, period_s) > 1.0


@pytest.fixture(scope="module")
def cell(tmp_path_factory) -> scene.Cell:
    return cells.build(tmp_path_factory.mktemp("reaction"), cells.duet())


def faults(cell: scene.Cell, **tables: dict) -> list[str]:
    changed = {
        name: getattr(cell.scenario, name).model_copy(update=new) for name, new in tables.items()
    }
    settings = cell.scenario.model_copy(update=changed)
    return reaction.faults(scene.Cell(**(vars(cell) | {"scenario": settings})))


def test_latency_counts_as_reaction_time(cell):
    assert not faults(cell)
    without = reaction.smallest_t_min_s(cell, "nurse")
    (fault,) = faults(cell, simulation={"latency_ticks": 3}, control={"t_min_s": without + 0.01})
    assert fault.startswith(
        f"control.t_min_s = {without + 0.01:g}: too small for arm nurse to brake in"
    )
    assert f"reaction time of {4 * 0.008 + 0.004:.3g} s" in fault
    assert reaction.smallest_t_min_s(cell, "surgeon") == 0.0


def test_a_gain_that_latency_makes_unstable_is_refused(cell):
    (fault,) = faults(cell, simulation={"latency_ticks": 25})
    assert fault.startswith(
        "control.task_gain_per_s = 10: with period_s = 0.008 and a state that is 0.2 s old"
    )
    assert "simulation.latency_ticks = 25" in fault
    assert "allowed is 3.8" in fault


def test_a_change_obeys_the_same_rule(tmp_path):
    content = cells.duet()
    content["change"] = [{"time_s": 1.0, "t_min_s": 0.5}, {"time_s": 2.0, "t_min_s": 0.001}]
    with pytest.raises(InputError, match=r"change\.1\.t_min_s = 0\.001: too small for arm nurse"):
        admit(cells.load(tmp_path, content), tmp_path / "scene")
