"""A person who wants things from another side says so while they are on their way."""

from __future__ import annotations

import numpy as np
import pytest

from tests import cells
from workcell import run as runner
from workcell import scenario as scenario_file
from workcell.errors import InputError
from workcell.live.devices import WindowKeys
from workcell.live.operator_file import REPLAY_FILE, write_replay
from workcell.regression import replay
from workcell.regression.compare import compare
from workcell.regression.excerpt import excerpt
from workcell.regression.rows import states
from workcell.trace.table import load

LEFT_KEY, RIGHT_KEY, ABOVE_KEY = 321, 323, 325
"""GLFW's codes of the keypad's 1, 3 and 5."""
ASKED_AT = 60


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The nurse comes from the left; a second later the person asks for the right."""
    folder = tmp_path_factory.mktemp("entry")
    content = cells.duet()
    content["simulation"] |= {"duration_s": 2.0, "period_s": 0.02}
    content["check"] = {"enabled": False}
    content["arm"][1]["job"] = [{"kind": "present", "arm": "surgeon", "entry": "left"}]
    cell = runner.prepare(cells.load(folder, content), folder / "run" / runner.SCENE_FOLDER)

    def person(tick, data, controller):
        if tick == ASKED_AT:
            controller.tune(entry="right")

    runner.simulate(cell, folder / "run", watch=person)
    return cell, folder / "run"


def test_the_way_changes_when_the_person_asks_and_the_trace_says_so(run):
    trace = load(run[1])
    assert set(trace["entry"][:ASKED_AT]) == {""}
    assert set(trace["entry"][ASKED_AT:]) == {"right"}
    clock = trace["nurse.path_s"]
    assert clock[ASKED_AT] < clock[ASKED_AT - 1], "a new path"
    step = np.linalg.norm(np.diff(trace["nurse.target_position_m"], axis=0), axis=1)
    assert step.max() < 0.15 * 0.02 * 1.01, "without a leap of the target"


def test_such_a_run_is_replayed_from_its_changes(run):
    cell, folder = run
    write_replay(folder)
    again = replay.closed_loop(scenario_file.load(folder / REPLAY_FILE), folder / "closed").trace
    trace = load(folder)
    for name in ("qpos", "nurse.target_position_m", "nurse.path_s", "entry"):
        np.testing.assert_array_equal(again[name], trace[name])
    opened = replay.open_loop(cell, states(trace), folder / "open").trace
    result = compare(excerpt(opened), excerpt(trace), without_plant=True)
    assert result.kind == "same", result.headline()


def test_keys_name_the_side_and_the_last_one_counts():
    keys = WindowKeys(held=lambda keys: set())
    assert keys.take(0.01).entry is None
    for key, side in ((LEFT_KEY, "left"), (RIGHT_KEY, "right"), (ABOVE_KEY, "above")):
        keys.press(key)
        assert keys.take(0.01).entry == side
    keys.press(ABOVE_KEY)
    asked = keys.take(0.01)
    keys.press(LEFT_KEY)
    assert asked.and_then(keys.take(0.01)).entry == "left"
    assert asked.and_then(keys.take(0.01)).entry == "above", "silence takes nothing back"


def test_a_side_that_does_not_exist_is_refused(tmp_path):
    content = cells.duet()
    content["change"] = [{"time_s": 1.0, "entry": "below"}]
    with pytest.raises(InputError, match=r"entry = 'below': .*'left', 'right' or 'above'"):
        cells.load(tmp_path, content)
    content["change"] = [{"time_s": 1.0}]
    with pytest.raises(InputError, match="a change needs t_min_s, criterion or entry"):
        cells.load(tmp_path, content)
