"""An operator from a plug-in: found by name, its options judged by its own model, its answers checked."""

from __future__ import annotations

import hashlib
import re

import numpy as np
import pytest

from tests import cells
from workcell import plugins
from workcell import run as runner
from workcell.errors import InputError
from workcell.trace.table import load

CIRCLE = '''
import numpy as np
from pydantic import BaseModel, ConfigDict, Field
from workcell.motion.path import Target
from workcell.motion.setpoint import Setpoint


class Circle:
    """Moves the tool on a circle."""

    class Options(BaseModel):
        model_config = ConfigDict(extra="forbid")
        radius_m: float = Field(0.02, gt=0, le=0.1)
        fault: str = ""

    def __init__(self, setup):
        self.setup = setup

    def setpoint(self, time_s):
        radius, fault = self.setup.options.radius_m, self.setup.options.fault
        if fault == "raises" and time_s > 0.1:
            raise ValueError("out of ideas")
        if fault == "answers" and time_s > 0.1:
            return "left"
        turn = radius * np.array([np.cos(time_s) - 1.0, np.sin(time_s), 0.0])
        rate = radius * np.array([-np.sin(time_s), np.cos(time_s), 0.0])
        position = self.setup.position_m + turn
        if fault == "nan" and time_s > 0.1:
            position = position * np.nan
        if fault == "shape" and time_s > 0.1:
            position = position[:2]
        target = Target(position, self.setup.wxyz, rate, np.zeros(3))
        return Setpoint(target, "circle", "asleep" if fault == "state" else "valid")


OPERATORS = {"circle": Circle}
'''


@pytest.fixture(autouse=True)
def circle(tmp_path, monkeypatch):
    monkeypatch.setenv(plugins.FILES_VARIABLE, "")
    (tmp_path / "circle.py").write_text(CIRCLE)
    plugins.use_files([tmp_path / "circle.py"])


def scenario_of(folder, **operator):
    content = cells.duet()
    content["simulation"] |= {"duration_s": 0.5, "period_s": 0.01}
    content["check"] = {"enabled": False}
    content["arm"][0]["operator"] = {"kind": "plugin", "name": "circle", **operator}
    return cells.load(folder, content)


def test_it_drives_its_arm_and_goes_into_the_scenario_of_the_run(tmp_path):
    loaded = scenario_of(tmp_path, options={"radius_m": 0.03})
    summary = runner.run(loaded, tmp_path / "run")
    trace = load(tmp_path / "run")
    digest = hashlib.sha256((tmp_path / "circle.py").read_bytes()).hexdigest()
    for versions in (summary["versions"], trace.metadata["versions"]):
        assert versions["operator circle"] == f"circle.py {digest[:12]}"
    assert set(trace["surgeon.job"]) == {"circle"}
    way = trace["surgeon.target_position_m"] - trace["surgeon.target_position_m"][0]
    assert np.linalg.norm(way[-1]) == pytest.approx(2 * 0.03 * np.sin(0.49 / 2), rel=1e-6)
    assert "radius_m = 0.03" in (tmp_path / "run" / "scenario.toml").read_text()


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("raises", "operator 'circle' raised ValueError: out of ideas"),
        ("answers", "operator 'circle' answered with str; allowed is a Setpoint"),
        ("nan", "target.position_m = \\[nan, nan, nan\\]: is not finite"),
        ("shape", "target.position_m of shape \\(2,\\); allowed is an array \\(3,\\)"),
    ],
)
def test_one_that_fails_ends_the_run_with_its_name(tmp_path, fault, said):
    summary = runner.run(scenario_of(tmp_path, options={"fault": fault}), tmp_path / "run")
    assert not summary["held"]
    assert re.search(said, summary["metrics"]["fault"]), summary["metrics"]["fault"]


def test_one_that_gives_no_first_setpoint_is_refused_before_the_run(tmp_path):
    with pytest.raises(InputError, match="operator 'circle' answered with state 'asleep'; allowed"):
        runner.run(scenario_of(tmp_path, options={"fault": "state"}), tmp_path / "run")
    assert not (tmp_path / "run" / "trace.parquet").exists()


def test_unknown_names_and_options_are_refused_with_the_known_ones(tmp_path):
    with pytest.raises(
        InputError, match=r"unknown operator 'cirle'; known here: circle; did you mean 'circle'\?"
    ):
        scenario_of(tmp_path, name="cirle")
    with pytest.raises(
        InputError,
        match=r"operator\.circle\.radius: unknown key 'radius'; allowed here: fault, radius_m; did you mean 'radius_m'",
    ):
        scenario_of(tmp_path, options={"radius": 1})
    with pytest.raises(InputError, match=r"operator\.circle\.radius_m: Input should be less than"):
        scenario_of(tmp_path, options={"radius_m": 3.0})


def test_a_scenario_cannot_name_a_file_to_be_run(tmp_path, monkeypatch):
    """Opening a stranger's scenario runs no stranger's code: a path is not a name."""
    trap = tmp_path / "trap.py"
    trap.write_text("raise SystemExit('run')\n")
    monkeypatch.chdir(tmp_path)
    for name in ("trap.py", str(trap), "trap", "os:system"):
        with pytest.raises(InputError):
            scenario_of(tmp_path, name=name)
