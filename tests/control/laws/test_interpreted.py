"""The laws as plain Python do what the compiled ones do: what is read is what runs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import mujoco
import numpy as np
import pytest

from workcell import scenario
from workcell.control.controller import Controller
from workcell.control.laws import arithmetic
from workcell.scene import cell as scene

TICKS = 25
ROUNDING = 1e-9
"""Both add in the same order; where they part is what the compiler joins into one multiplication and addition."""


def commands(name: str) -> list[list[float]]:
    """The commands of the first ticks of a scenario, at 20 ms, its plant following them exactly."""
    asked = scenario.load(name, ("simulation.plant=kinematic", "simulation.period_s=0.02"))
    with tempfile.TemporaryDirectory() as folder:
        cell = scene.build(asked, Path(folder))
    controller, data = Controller(cell), mujoco.MjData(cell.model)
    cell.place_home(data)
    told = []
    for _ in range(TICKS):
        command = controller.step(data.qpos, data.qvel).command_rad_s
        told.append(command.tolist())
        data.qvel[:] = command
        mujoco.mj_integratePos(cell.model, data.qpos, data.qvel, cell.period_s)
    return told


@pytest.mark.parametrize("name", ["surgeon_sweeps", "take_instrument"])
def test_interpreted_laws_command_the_same(name):
    ran = subprocess.run(
        [sys.executable, "-m", "tests.control.laws.test_interpreted", name],
        env=os.environ | {"NUMBA_DISABLE_JIT": "1"}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    how, told = json.loads(ran.stdout)
    assert how == "interpreted"
    assert arithmetic() != how
    assert np.abs(told).max() > 0.01  # the arms are under way
    np.testing.assert_allclose(told, commands(name), rtol=0, atol=ROUNDING)


if __name__ == "__main__":
    print(json.dumps([arithmetic(), commands(sys.argv[1])]))
