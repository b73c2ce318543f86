"""Strategies are chosen by name, and one that cannot be used ends in a named safe state."""

from __future__ import annotations

import re
import textwrap
import time

import numpy as np
import pytest
from numba.core import event

from workcell import plugins
from workcell import run as runner
from workcell import scenario as scenario_file
from workcell.control import asking
from workcell.control.tick import Steering
from workcell.errors import InputError
from workcell.trace.table import load

SHORT = (
    "simulation.plant=kinematic",
    "simulation.period_s=0.02",
    "simulation.duration_s=1.0",
    "check.enabled=false",
    "expect={}",
)
BAD = """
import time
import numpy as np
from workcell.control.tick import Steering

class Bad:
    def __init__(self, setup):
        self.ticks = 0
    def steer(self, view):
        self.ticks += 1
        good = Steering(view.task_rad_s * 0.2, view.task_rad_s)
        if self.ticks < 20:
            return good
        {fault}

STRATEGIES = {{"bad": Bad}}
"""


@pytest.fixture(autouse=True)
def own_environment(monkeypatch):
    monkeypatch.setenv(plugins.FILES_VARIABLE, "")


def crossing(*overrides):
    return scenario_file.load("planar_crossing", (*SHORT, *overrides))


@pytest.mark.parametrize("name", sorted(plugins.BUILT_IN["strategies"]))
def test_every_built_in_strategy_drives_the_arms_and_answers_soundly(name, tmp_path):
    summary = runner.run(crossing(f"control.strategy={name}"), tmp_path)
    assert summary["metrics"]["fault"] is None
    trace = load(tmp_path)
    assert np.abs(trace["command_rad_s"]).max() > 0.02
    assert "strategy_fault" not in set(trace["nurse.reason"])


def test_an_arm_may_have_a_strategy_of_its_own_with_options(tmp_path):
    summary = runner.run(
        crossing("arm.nurse.strategy=cbf", "strategy={cbf={deviation_m=0.2}}"), tmp_path
    )
    assert summary["metrics"]["fault"] is None


@pytest.mark.parametrize(
    ("override", "said"),
    [
        (
            "control.strategy=cbff",
            r"control\.strategy: unknown strategy 'cbff'; known here: .*; did you mean 'cbf'\?",
        ),
        ("arm.surgeon.strategy=cbf", r"arm\.surgeon\.strategy: only an arm with jobs"),
        ("strategy={cbf={deviation_m=-1.0}}", r"strategy\.cbf\.deviation_m: .*greater than 0"),
        ("strategy={cbf={deviatoin_m=1.0}}", r"strategy\.cbf\.deviatoin_m"),
        ("strategy={nosuch={}}", r"strategy\.nosuch: unknown strategy 'nosuch'"),
    ],
)
def test_a_strategy_that_is_not_there_and_options_it_does_not_take_are_refused(override, said):
    with pytest.raises(InputError, match=said):
        crossing(override)


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("raise KeyError('lost')", "raised KeyError: 'lost'"),
        ("return good._replace(velocity_rad_s=good.velocity_rad_s * np.nan)", "velocity_rad_s"),
        ("return good._replace(velocity_rad_s=np.zeros(99))", r"shape \(99,\), must be \(3,\)"),
        ("return None", "answered with NoneType"),
        ("return good._replace(clock_rate=7.0)", "clock_rate = 7.0"),
        ("return good._replace(mode='fly')", "mode = 'fly'"),
        ("time.sleep(10.0); return good", "TimeoutError: no answer within"),
        ("while True: pass", "TimeoutError: no answer within"),
    ],
)
def test_a_strategy_that_cannot_be_used_ends_in_a_named_safe_state(
    fault, said, tmp_path, monkeypatch
):
    monkeypatch.setattr(asking, "TIME_LIMIT_S", 0.2)
    monkeypatch.setattr(asking, "WAIT_LIMIT_S", 0.4)
    file = tmp_path / "bad.py"
    file.write_text(textwrap.dedent(BAD).format(fault=fault), encoding="utf-8")
    plugins.use_files([file])
    summary = runner.run(crossing("control.strategy=bad"), tmp_path / "out")
    assert not summary["held"]
    assert "strategy 'bad' of arm nurse" in summary["metrics"]["fault"]
    assert re.search(said, summary["metrics"]["fault"])
    assert summary["versions"]["strategy bad"].startswith("bad.py ")
    trace = load(tmp_path / "out")
    assert trace["nurse.reason"][-1] == "strategy_fault"
    assert trace["nurse.mode"][-1] == "halt"
    nurse = trace["command_rad_s"][-1][np.array(trace.metadata["dofs"]["nurse"])]
    assert np.abs(nurse).max() == 0.0


def test_what_is_compiled_meanwhile_is_not_taken_for_a_strategy_that_hangs(monkeypatch):
    """In a fresh installation the first tick of a plug-in compiles laws for longer than a strategy may take."""
    monkeypatch.setattr(asking, "TIME_LIMIT_S", 0.1)
    monkeypatch.setattr(asking, "WAIT_LIMIT_S", 0.3)
    answered = Steering(np.zeros(3), np.zeros(3))

    def compiles() -> Steering:
        with event.trigger_event("numba:compile", data={"dispatcher": None}):
            time.sleep(0.7)
        return answered

    def compiles_and_hangs() -> Steering:
        compiles()
        time.sleep(10.0)
        return answered

    assert asking.ask("mine", "nurse", compiles, n=3, pairs=1, timed=True) is answered
    began = time.monotonic()
    with pytest.raises(asking.StrategyFault, match=r"no answer within 0\.3 s"):
        asking.ask("mine", "nurse", compiles_and_hangs, n=3, pairs=1, timed=True)
    assert time.monotonic() - began < 5.0


def test_one_that_a_busy_machine_keeps_waiting_loses_nothing_and_one_that_computes_for_ever_does(
    monkeypatch,
):
    """Only plug-ins are timed: by the wall's clock alone they would lose races that built-in ones win."""
    monkeypatch.setattr(asking, "TIME_LIMIT_S", 0.1)
    answered = Steering(np.zeros(3), np.zeros(3))

    def kept_waiting() -> Steering:
        time.sleep(0.5)
        return answered

    def computes() -> Steering:
        while True:
            pass

    assert asking.ask("mine", "nurse", kept_waiting, n=3, pairs=1, timed=True) is answered
    with pytest.raises(asking.StrategyFault, match=r"no answer within 0\.1 s of processor time"):
        asking.ask("mine", "nurse", computes, n=3, pairs=1, timed=True)


def test_a_scenario_file_cannot_make_code_run(tmp_path):
    evil = tmp_path / "evil.py"
    evil.write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\nSTRATEGIES = {{'evil': object}}\n")
    for name in (str(evil), "evil", "evil:object", "os:system", "../evil.py"):
        with pytest.raises(InputError):
            crossing(f"control.strategy={name}")
    with pytest.raises(InputError):
        crossing(f"strategy={{evil={{plugin='{evil}'}}}}")
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("class Bad:\n    def __init__(self, setup): raise KeyError('what')", "KeyError: 'what'"),
        ("Bad = 3", "'int' object is not callable"),
        ("def Bad(): ...", "takes 0 positional arguments"),
    ],
)
def test_a_strategy_that_cannot_be_made_is_refused_before_the_run(text, said, tmp_path):
    (tmp_path / "bad.py").write_text(f"{text}\nSTRATEGIES = {{'bad': Bad}}\n")
    plugins.use_files([tmp_path / "bad.py"])
    with pytest.raises(InputError, match=f"strategy 'bad' cannot be made: .*{said}"):
        runner.run(crossing("control.strategy=bad"), tmp_path / "run")
    assert not (tmp_path / "run").exists()
