"""The search finds a planted fault, shrinks it to the keys that make it, and says so when there is none."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests import cells
from tests.study.staged import Staged
from workcell import scenario as scenario_file
from workcell.errors import InputError
from workcell.scenario import Scenario
from workcell.study.falsify import POPULATION, falsify
from workcell.study.vary import Variations


def variations(folder: Path) -> Variations:
    content = cells.duet()
    content["simulation"] = {"plant": "kinematic", "period_s": 0.02, "duration_s": 1.0}
    content["vary"] = {
        "control.t_min_s": {"min": 0.9, "max": 1.5},
        "control.d_min_m": {"min": 0.005, "max": 0.02},
        "arm.nurse.home_rad": {"plus_minus": 0.05},
        "simulation.seed": {"min": 0, "max": 100},
    }
    return Variations(cells.load(folder, content))


def planted(run: int, setting: str, scenario: Scenario) -> dict[str, Any]:
    """A support arm comes the nearer the longer t_min is, and touches beyond 1.4 s; nothing else matters."""
    distance_m = 0.14 - 0.1 * scenario.control.t_min_s
    in_time = scenario.simulation.duration_s > 0.4
    touch = distance_m < 0.0 and in_time
    return {
        "smallest_support_m": distance_m if in_time else 0.05,
        "contact_cause": "support" if touch else "",
        "smallest_ttc_command_own_s": scenario.control.t_min_s,
    }


def test_a_planted_fault_is_found_and_shrunk_to_its_cause(tmp_path: Path):
    executor = Staged(planted)
    case = falsify(variations(tmp_path), "distance", tmp_path / "out", executor, runs=64, seed=0)
    assert case.fails
    assert case.score < 0.0
    assert list(case.values) == ["control.t_min_s"]
    assert case.values["control.t_min_s"] > 1.4
    # Cut to half its time it still fails, to a quarter not any more.
    assert case.scenario.simulation.duration_s == pytest.approx(0.5)
    written = scenario_file.load(tmp_path / "out" / "case.toml")
    assert written.name == "duet_distance"
    assert written.control.t_min_s == case.values["control.t_min_s"]
    assert written.expect["contact"].equals is False
    assert (tmp_path / "out" / "case" / "summary.json").is_file()
    tried = (tmp_path / "out" / "tried.jsonl").read_text().splitlines()
    assert len(tried) == case.tried == len(executor.made)
    first = [json.loads(line)["score"] for line in tried[:POPULATION]]
    last = [json.loads(line)["score"] for line in tried[64 - POPULATION : 64]]
    # The search follows the distance: its last generation is nearer to the fault than its first.
    assert sum(last) < sum(first)


def test_nothing_found_is_the_worst_of_what_was_tried(tmp_path: Path):
    case = falsify(variations(tmp_path), "ttc", tmp_path / "out", Staged(planted), runs=32, seed=0)
    assert not case.fails
    assert case.score > 0.0
    assert case.tried == 32
    assert not scenario_file.load(tmp_path / "out" / "case.toml").expect


def test_too_few_runs_are_refused(tmp_path: Path):
    with pytest.raises(InputError, match=f"allowed is {2 * POPULATION} or more"):
        falsify(variations(tmp_path), "ttc", tmp_path, Staged(planted), runs=20, seed=0)
