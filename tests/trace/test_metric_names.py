"""The list of metrics is what summaries hold, and what `[expect]` may ask for."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests import cells
from workcell import assets, scenario
from workcell import run as runner
from workcell.errors import InputError
from workcell.trace import expectations
from workcell.trace.metric_names import is_metric, names

REFERENCES = sorted((Path(__file__).parents[1] / "replay" / "references").glob("*/reference.json"))


@pytest.mark.parametrize("path", REFERENCES, ids=lambda path: path.parent.name)
def test_every_metric_of_a_reference_is_listed(path):
    kept = json.loads(path.read_text(encoding="utf-8"))
    unlisted = [name for name in kept["metrics"] if not is_metric(name, kept["arms"])]
    assert not unlisted


def test_every_metric_of_a_run_is_listed(tmp_path):
    summary = runner.run(
        cells.load(tmp_path, cells.duet(), "simulation.duration_s=0.1"), tmp_path / "run"
    )
    assert [x for x in summary["metrics"] if not is_metric(x, ("surgeon", "nurse"))] == []


@pytest.mark.parametrize("name", assets.scenario_names())
def test_shipped_scenarios_expect_metrics_that_exist(name):
    assert expectations.faults(scenario.load(name)) == []


def test_names_of_a_cell_are_metrics_of_it():
    arms = ("surgeon", "nurse")
    assert all(is_metric(name.replace("*", "2"), arms) for name in names(arms))
    assert is_metric("nurse.mode_self_motion_ticks", arms)
    assert not is_metric("assistant.mode_halt_ticks", arms)
    assert not is_metric("mode_ticks", arms)


def test_a_name_that_is_no_metric_is_answered_with_the_nearest(tmp_path):
    loaded = cells.load(
        tmp_path, cells.duet(), "expect.smalest_ttc_s={min=1.0}", "expect.completed=true"
    )
    (fault,) = expectations.faults(loaded)
    assert fault.startswith("expect.smalest_ttc_s: is not a metric of this cell")
    assert "did you mean 'smallest_ttc_s'?" in fault


@pytest.mark.parametrize(
    ("bound", "words"),
    [
        ("contact='no'", "expect.contact: is true or false, not {'equals': 'no'}"),
        ("contact={max=1.0}", "expect.contact: is true or false"),
        ("smallest_ttc_s='big'", "expect.smallest_ttc_s: is a number; allowed are min, max"),
        ("smallest_ttc_s=true", "expect.smallest_ttc_s: is a number"),
        ("stopped_by_check=false", "expect.stopped_by_check: is a text"),
        ("smallest_ttc_s={min=1.0,max=0.0}", None),
        ("mode_changes=3", ""),
        ("stopped_by_check='none'", ""),
        ("contact=false", ""),
    ],
)
def test_a_value_that_the_metric_cannot_have_is_refused(tmp_path, bound, words):
    if words is None:
        with pytest.raises(InputError, match="min = 1 is above max = 0"):
            cells.load(tmp_path, cells.duet(), f"expect.{bound}")
        return
    found = expectations.faults(cells.load(tmp_path, cells.duet(), f"expect.{bound}"))
    assert [fault[: len(words)] for fault in found] == ([words] if words else [])
