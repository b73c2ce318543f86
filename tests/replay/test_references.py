"""Every shipped scenario against its reference: open loop, then closed loop.

A failure here says that behaviour changed. If it was meant to, bless it with a reason:

    make bless SCENARIO=handover REASON="the factor may rise faster"
"""

from pathlib import Path

import pytest

from workcell import assets
from workcell import scenario as scenario_file
from workcell.regression import reference as regression
from workcell.regression.settings import settings_changes

REFERENCES = Path(__file__).parent / "references"
NAMES = regression.names(REFERENCES)
HINT = 'if that is meant: make bless SCENARIO={} REASON="..."'


def test_every_scenario_has_a_reference_and_no_reference_is_left_over():
    assert assets.scenario_names() == NAMES, HINT.format("...")


@pytest.mark.parametrize("name", NAMES)
def test_the_reference_is_of_the_scenario_as_it_is(name):
    reference = regression.load(REFERENCES / name)
    today = scenario_file.load(name, reference.overrides)
    changes = settings_changes(
        today.model_dump(mode="json"), reference.scenario.model_dump(mode="json")
    )
    assert changes == [], HINT.format(name)
    assert today.expect, "nobody would see it stop engaging what it is meant to"


@pytest.mark.parametrize("name", NAMES)
def test_open_loop(name, tmp_path):
    result = regression.check_open_loop(regression.load(REFERENCES / name), tmp_path)
    assert result.kind == "same", f"{result.headline()}; {HINT.format(name)}"


@pytest.mark.parametrize("name", NAMES)
def test_closed_loop(name, tmp_path):
    reference = regression.load(REFERENCES / name)
    today = scenario_file.load(name, reference.overrides)
    result = regression.check_closed_loop(reference, tmp_path, expect=today.expect)
    assert result.unmet == (), "it no longer engages what it is meant to engage"
    assert result.metrics == (), HINT.format(name)
    assert result.comparison.kind == "same", f"{result.comparison.headline()}; {HINT.format(name)}"
