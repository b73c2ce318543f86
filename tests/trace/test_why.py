"""A run that is not as expected says why: job, time, pair, what was tried."""

from __future__ import annotations

from tests import cells
from workcell import cli
from workcell import run as runner


def blocked(folder, *overrides):
    """A nurse that is to meet a tool it would need much longer for."""
    loaded = cells.load(
        folder, cells.duet(), "simulation.duration_s=1.6", "expect.completed=true", *overrides
    )
    return runner.run(loaded, folder / "run")


def test_a_run_that_held_needs_no_words(tmp_path):
    summary = runner.run(
        cells.load(tmp_path, cells.duet(), "simulation.duration_s=0.1"), tmp_path / "run"
    )
    assert summary["held"]
    assert summary["why"] == []


def test_an_unfinished_job_is_told_with_its_time_and_what_held_the_arm(tmp_path):
    summary = blocked(tmp_path)
    told = "\n".join(summary["why"])
    assert not summary["held"]
    assert "Expected of completed was true, it is false." in told
    assert "nurse was at its job meet since 0.0 s" in told
    assert "nothing was tried against an impasse" in told


def test_a_pair_that_holds_an_arm_back_is_named(tmp_path):
    summary = blocked(tmp_path, "arm.nurse.job.0.speed_m_s=0.1", "control.t_min_s=60")
    told = "\n".join(summary["why"])
    assert "held back since the time to collision would fall below t_min" in told
    assert "_capsule and " in told


def test_the_command_line_prints_it(tmp_path, capsys):
    path = cells.write(tmp_path, cells.duet())
    short = ("--set", "simulation.duration_s=0.8", "--set", "expect.completed=true")
    assert cli.main(["run", str(path), "--out", str(tmp_path / "run"), *short]) == 1
    assert "nurse was at its job meet" in capsys.readouterr().err
