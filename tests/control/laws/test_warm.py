"""`workcell compile` leaves nothing for a tick to compile."""

from __future__ import annotations

import pytest

from workcell import run as runner
from workcell import scenario as scenario_file
from workcell.control.laws import cache_folder
from workcell.control.warm import warm


@pytest.mark.long
@pytest.mark.parametrize("name", ["handover", "hostile_hand", "take_instrument", "three_arms"])
def test_after_it_no_run_compiles_a_law(tmp_path, name):
    """Out of reach, gated, beyond the cap: what a law is called with has its machine code already."""
    warm()
    there = {file.name for file in cache_folder().rglob("*.nbc")}
    assert there
    quick = ("simulation.duration_s=6.0", "check.enabled=false", "simulation.period_s=0.01")
    plain = scenario_file.load(name, (*quick, "simulation.plant=kinematic"))
    capped = scenario_file.load(name, (*quick, "control.point_speed_m_s=0.05"))
    for k, scenario in enumerate((plain, capped)):
        cell = runner.prepare(scenario, tmp_path / str(k) / runner.SCENE_FOLDER)
        assert runner.simulate(cell, tmp_path / str(k)).fault is None
    assert {file.name for file in cache_folder().rglob("*.nbc")} == there
