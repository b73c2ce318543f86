"""What `workcell new` writes works as it is."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import workcell
from workcell.cli import main


@pytest.mark.parametrize("what", ["scenario", "arm"])
def test_a_new_scenario_and_a_new_arm_run_and_hold(what, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["new", what, "first"]) == 0
    assert main(["check", "first.toml"]) == 0
    assert main(["run", "first.toml", "--set", "simulation.period_s=0.02"]) == 0


@pytest.mark.parametrize("what", ["strategy", "criterion"])
def test_a_new_strategy_and_a_new_criterion_pass_their_own_tests(what, tmp_path):
    assert main(["new", what, "mine", "--out", str(tmp_path)]) == 0
    root = Path(workcell.__file__).parents[1]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(tmp_path)],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout


def test_a_new_strategy_can_be_the_first_thing_that_a_command_imports(tmp_path):
    """A plug-in file is run before anything of the controller is there; its imports must not ask for itself."""
    assert main(["new", "strategy", "mine", "--out", str(tmp_path)]) == 0
    root = Path(workcell.__file__).parents[1]
    done = subprocess.run(
        [sys.executable, "-m", "workcell", "plugins", "--plugin", "mine.py"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(root), "WORKCELL_PLUGINS": ""},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert re.search(r"strategy +mine ", done.stdout)


def test_nothing_is_overwritten_and_a_name_is_a_name(tmp_path, capsys):
    assert main(["new", "scenario", "first", "--out", str(tmp_path)]) == 0
    assert main(["new", "scenario", "first", "--out", str(tmp_path)]) == 2
    assert "is there already and is kept" in capsys.readouterr().err
    for name in ("../evil", "A", "9", ""):
        assert main(["new", "scenario", name, "--out", str(tmp_path)]) == 2
