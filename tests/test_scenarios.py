"""Every shipped scenario: it reads, says what it is for, can be run, engages, and shows what it promises."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest

from workcell import assets
from workcell import run as runner
from workcell import scenario as scenario_file
from workcell.trace.table import load

NAMES = assets.scenario_names()


@pytest.mark.parametrize("name", NAMES)
def test_it_says_what_it_is_for_and_what_must_happen(name):
    text = assets.scenario_file(name).read_text(encoding="utf-8")
    assert text.startswith("# "), "it opens with a comment: what it is for and what must happen"
    assert tomllib.loads(text)["description"]
    loaded = scenario_file.load(name)
    assert loaded.name == name
    assert loaded.expect, "a scenario is a test"


@pytest.mark.parametrize("name", NAMES)
def test_it_starts_and_engages(name, tmp_path):
    """A third of a second on the ideal plant: finite, solved, without warnings of MuJoCo, and something moves."""
    overrides = ("simulation.plant=kinematic", "simulation.duration_s=0.3", "check.enabled=false")
    scenario = scenario_file.load(name, overrides)
    summary = runner.run(scenario, tmp_path)
    trace = load(tmp_path)
    assert summary["metrics"]["fault"] is None
    assert len(trace) == scenario.ticks
    assert np.isfinite(trace["command_rad_s"]).all()
    assert np.abs(trace["command_rad_s"]).max() > 0
    assert trace["pair_distance_m"].min() > scenario.control.d_min_m
    for arm in trace.layout.arms:
        assert set(trace[f"{arm}.ik_status"]) == {"optimal"}


@pytest.mark.long
@pytest.mark.parametrize("name", NAMES)
def test_it_shows_what_it_promises(name, tmp_path):
    summary = runner.run(scenario_file.load(name), tmp_path)
    assert summary["held"], summary["expectations"]


@pytest.mark.long
def test_handover_holds_on_the_exact_plant_too(tmp_path):
    summary = runner.run(scenario_file.load("handover", ("simulation.plant=kinematic",)), tmp_path)
    assert summary["held"], summary["expectations"]


@pytest.mark.long
def test_handover_does_not_get_through_without_the_criterion(tmp_path):
    summary = runner.run(scenario_file.load("handover", ("control.criterion=none",)), tmp_path)
    assert summary["expectations"]["completed"]["held"] is False
    assert summary["expectations"]["contact"]["held"] is True, "stuck, but never in contact"
