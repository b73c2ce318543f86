"""The study with a hostile hand: whose operator is replaced, and what its table counts."""

from __future__ import annotations

import json

import pytest

from workcell import scenario as scenario_file
from workcell.errors import InputError
from workcell.study.hostile import SCENARIOS, runs, table, variations


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_scenario_gets_the_hostile_hand_and_its_variations(name):
    hand = scenario_file.load("hostile_hand").arm[0]
    found = variations(name, ("simulation.plant=kinematic", "simulation.period_s=0.01"))
    drawn = found.scenario(found.draw(1, 0))
    surgeon = next(arm for arm in drawn.arm if arm.name == hand.name)
    assert surgeon.operator.kind == hand.operator.kind
    assert found.keys
    assert drawn.simulation.plant == "kinematic"


def test_runs_are_dealt_out_and_the_same_every_time():
    first, again = (list(runs(("hostile_hand", "handover"), 4, 3, ())) for _ in range(2))
    assert [name for name, *_ in first] == ["hostile_hand", "handover"] * 2
    assert [values for *_, values, _, _ in first] == [values for *_, values, _, _ in again]


def test_a_scenario_without_that_arm_is_refused(tmp_path):
    from tests import cells

    content = cells.duet()
    for arm in content["arm"]:
        arm["name"] = {"surgeon": "person", "nurse": "nurse"}[arm["name"]]
    content["arm"][1]["job"][0]["arm"] = "person"
    path = cells.write(tmp_path, content)
    with pytest.raises(InputError, match="has no arm 'surgeon' for the hostile hand to drive"):
        variations(str(path))


def test_the_table_counts_what_the_judge_said(tmp_path):
    rows = [
        {
            "scenario": "a",
            "status": "ran",
            "contact_cause": "support",
            "short_ticks": 3,
            "tool_error_m": 0.001,
        },
        {
            "scenario": "a",
            "status": "ran",
            "contact_cause": "priority",
            "short_ticks": 0,
            "tool_error_m": None,
        },
        {
            "scenario": "b",
            "status": "refused",
            "contact_cause": "",
            "short_ticks": None,
            "tool_error_m": None,
        },
        {
            "scenario": "b",
            "status": "died",
            "contact_cause": "",
            "short_ticks": None,
            "tool_error_m": None,
        },
    ]
    journal = tmp_path / "runs.jsonl"
    journal.write_text("".join(json.dumps(row) + "\n" for row in rows), encoding="utf-8")
    *_, a, b, everything = table(journal).splitlines()
    assert a.startswith("| a | 2 | 1 of 2, 50 %")
    assert a.endswith("| 1 | 1 | 3 | 1.00 | 0 | 0 |")
    assert "no runs" in b
    assert b.endswith("| 1 | 1 |")
    assert everything.startswith("| all | 2 |")
