"""Arms that people publish, from packages that carry them, each imported by one command; their tools meet.

Where a package is not installed, its arms are skipped by name. WORKCELL_ARMS names another folder of packages.
"""

from __future__ import annotations

import os
import sys
import sysconfig
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.mjcf import published
from workcell import run, scenario
from workcell.cli import main

PACKAGES = Path(os.environ.get("WORKCELL_ARMS", sysconfig.get_paths()["purelib"]))
SHARED = (PACKAGES / "share", Path(sys.prefix) / "share")


def found(name: str, file: str) -> Path:
    """The file, or a skip that names what is missing."""
    for folder in (PACKAGES, *SHARED):
        if (folder / file).is_file():
            return folder / file
    pytest.skip(f"{name}: {file} is not in {PACKAGES}")


@pytest.mark.long
@pytest.mark.parametrize("name", published.ARMS)
def test_an_arm_that_people_publish_is_imported_by_one_command(tmp_path, name, capsys):
    file, _, joints = published.ARMS[name]
    found(name, file)
    folder = published.imported(name, PACKAGES, tmp_path)
    assert "first scenario: workcell run" in capsys.readouterr().out
    model = mujoco.MjModel.from_xml_path(str(folder / f"{name}.xml"))
    assert model.njnt == joints
    assert np.isfinite(model.jnt_range).all()
    assert main(["check", str(folder / f"{name}_pair.toml")]) == 0


@pytest.mark.long
@pytest.mark.parametrize("name", published.ARMS)
def test_two_of_them_meet_where_place_puts_them(tmp_path, name):
    found(name, published.ARMS[name][0])
    meeting, status = published.placed(published.imported(name, PACKAGES, tmp_path))
    assert status == 0
    asked = scenario.load(meeting, ("simulation.plant=kinematic",))
    summary = run.run(asked, tmp_path / "run")
    assert summary["held"], summary["why"]
    assert summary["metrics"]["smallest_ttc_command_own_s"] > 0.99
    assert summary["watched_pairs"] < 250


@pytest.mark.long
@pytest.mark.parametrize("name", published.ROBOTS_WITH_TWO)
def test_both_arms_of_a_robot_are_driven_in_one_cell(tmp_path, name):
    file, tool = published.ROBOTS_WITH_TWO[name]
    path = found(name, file)
    parts = [f"--part={side}={tool.format(side=side)}" for side in published.SIDES]
    assert main(["import", str(path), "--name", name, "--out", str(tmp_path), *parts]) == 0
    cell = tmp_path / name / f"{name}_cell.toml"
    summary = run.run(scenario.load(cell, ("simulation.plant=kinematic",)), tmp_path / "run")
    assert summary["held"], summary["why"]
