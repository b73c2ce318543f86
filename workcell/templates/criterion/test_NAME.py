"""Run with `pytest`: the criterion moves an arm, and no answer of it is refused."""

from pathlib import Path

from workcell import plugins
from workcell import run as runner
from workcell import scenario
from workcell.trace.table import load


def test_it_moves_an_arm(tmp_path):
    plugins.use_files([Path(__file__).with_name("NAME.py")])
    cell = scenario.load(
        "handover",
        (
            "control.criterion=NAME",
            "simulation.plant=kinematic",
            "simulation.period_s=0.02",
            "simulation.duration_s=4.0",
            "check.enabled=false",
            "expect={}",
        ),
    )
    summary = runner.run(cell, tmp_path / "run")
    assert summary["metrics"]["fault"] is None
    assert abs(load(tmp_path / "run")["command_rad_s"]).max() > 0.0
