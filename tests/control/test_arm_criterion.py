"""Criteria that plug-ins bring: what they are given, what is believed of their answers, and that nothing else runs."""

from __future__ import annotations

import re
import textwrap

import numpy as np
import pytest

from tests import cells
from workcell import plugins
from workcell import run as runner
from workcell.admission import admit
from workcell.control import asking
from workcell.errors import InputError
from workcell.trace.table import load

BARRIER = """
import numpy as np

def barrier(distance_m, rate_m_s, rows):
    #The signed ARTC of this package, written by a stranger.
    n = rows.shape[1]
    return np.zeros((n, n)), -(rows / np.maximum(distance_m, 1e-3)[:, None]).sum(axis=0) / max(1, len(rows))

CRITERIA = {"barrier": barrier}
"""
BAD = """
import time
import numpy as np

asked = []

def bad(distance_m, rate_m_s, rows):
    asked.append(len(rows))
    n = rows.shape[1]
    H, c = np.zeros((n, n)), np.zeros(n)
    if len(asked) < 20:
        return H, c
    FAULT

CRITERIA = {"bad": bad}
"""
SHORT = ("simulation.duration_s=1.0", "check.enabled=false")


@pytest.fixture(autouse=True)
def own_environment(monkeypatch):
    monkeypatch.setenv(plugins.FILES_VARIABLE, "")


def use(folder, text, name="mine.py"):
    file = folder / name
    file.write_text(text, encoding="utf-8")
    plugins.use_files([file])


def duet(folder, *overrides):
    """Arms that leave their tools' turns to the null space."""
    content = cells.duet()
    for arm in content["arm"]:
        arm["task"] = "position"
    return cells.load(folder, content, *SHORT, *overrides)


def commands(scenario, folder):
    summary = runner.run(scenario, folder)
    assert summary["metrics"]["fault"] is None
    return summary, load(folder)["command_rad_s"]


def test_one_that_is_written_again_outside_commands_the_same(tmp_path):
    _, own = commands(duet(tmp_path, "control.criterion=artc"), tmp_path / "own")
    use(tmp_path, BARRIER)
    summary, outside = commands(duet(tmp_path, "control.criterion=barrier"), tmp_path / "outside")
    np.testing.assert_allclose(outside, own, rtol=0, atol=1e-9)
    assert summary["versions"]["criterion barrier"].startswith("mine.py ")
    _, without = commands(duet(tmp_path, "control.criterion=none"), tmp_path / "none")
    assert np.abs(without - own).max() > 1e-3


def test_an_arm_may_have_a_criterion_of_its_own(tmp_path):
    _, both = commands(duet(tmp_path, "control.criterion=armd"), tmp_path / "both")
    one = duet(tmp_path, "control.criterion=none", "arm.surgeon.criterion=armd")
    _, mixed = commands(one, tmp_path / "mixed")
    assert np.abs(mixed - both).max() > 1e-3
    assert np.abs(mixed[:, :3]).max() > 1e-3  # the surgeon, who holds, still makes way


def test_options_are_those_of_its_model(tmp_path):
    use(
        tmp_path,
        "from pydantic import BaseModel\nimport numpy as np\n"
        "class Left:\n    class Options(BaseModel, extra='forbid'):\n        strength: float = 1.0\n"
        "    def __init__(self, options):\n        self.strength = (options or self.Options()).strength\n"
        "    def __call__(self, distance_m, rate_m_s, rows):\n        n = rows.shape[1]\n"
        "        return np.zeros((n, n)), -self.strength * np.ones(n)\nCRITERIA = {'left': Left}\n",
    )
    commands(
        duet(tmp_path, "control.criterion=left", "criterion={left={strength=0.01}}"),
        tmp_path / "out",
    )
    with pytest.raises(InputError, match=r"criterion\.left\.strenght"):
        duet(tmp_path, "criterion={left={strenght=1.0}}")


@pytest.mark.parametrize(
    ("override", "said"),
    [
        (
            "control.criterion=artcc",
            r"control\.criterion: unknown criterion 'artcc'; known here: .*armd.*; did you mean 'artc'",
        ),
        ("arm.nurse.criterion=what", r"arm\.nurse\.criterion: unknown criterion 'what'"),
        ("criterion={artc={gain=1.0}}", r"criterion\.artc: takes no options; given gain"),
    ],
)
def test_what_is_not_there_is_refused_by_key(tmp_path, override, said):
    with pytest.raises(InputError, match=said):
        duet(tmp_path, override)


def test_one_that_cannot_be_made_is_refused_before_the_run(tmp_path):
    use(tmp_path, "CRITERIA = {'number': 3}\n")
    with pytest.raises(
        InputError, match="criterion 'number': is int; allowed is a function or a class"
    ):
        admit(duet(tmp_path, "control.criterion=number"), tmp_path / "scene")


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("raise KeyError('lost')", "raised KeyError: 'lost'"),
        ("return H, c * np.nan", "a number that is not finite"),
        ("return H, np.zeros(99)", r"shapes \(3, 3\) and \(99,\), must be \(3, 3\) and \(3,\)"),
        ("return None", "raised TypeError"),
        ("return -np.eye(n), c", "not symmetric and positive semidefinite"),
        ("time.sleep(10.0); return H, c", "no answer within"),
    ],
)
def test_one_that_cannot_be_used_ends_in_a_named_safe_state(fault, said, tmp_path, monkeypatch):
    monkeypatch.setattr(asking, "TIME_LIMIT_S", 0.2)
    monkeypatch.setattr(asking, "WAIT_LIMIT_S", 0.4)
    use(tmp_path, textwrap.dedent(BAD).replace("FAULT", fault))
    summary = runner.run(duet(tmp_path, "arm.nurse.criterion=bad"), tmp_path / "out")
    assert not summary["held"]
    assert re.search(said, summary["metrics"]["fault"])
    if "sleep" not in fault:
        assert "criterion 'bad' of arm nurse" in summary["metrics"]["fault"]
    trace = load(tmp_path / "out")
    assert trace["nurse.reason"][-1] == "strategy_fault"
    assert (
        np.abs(trace["command_rad_s"][-1][np.array(trace.metadata["dofs"]["nurse"])]).max() == 0.0
    )
