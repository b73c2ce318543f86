"""A slice of the fuzz campaign; `make fuzz` makes all of it."""

from __future__ import annotations

import pytest

from tests.fuzz import harness
from tests.fuzz.targets import TARGETS

SLICE = {"scenario": 12, "arm": 6, "recording": 6, "run_folder": 2, "command_line": 10}


@pytest.mark.parametrize("name", sorted(TARGETS))
def test_no_case_ends_in_a_traceback_or_without_a_word(name):
    cases = list(harness.run(name, TARGETS[name], range(SLICE[name])))
    assert len(cases) == SLICE[name]
    assert [fault for case in cases for fault in case.faults] == []
