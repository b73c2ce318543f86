"""What people type: exit statuses, messages, and that it works from any folder."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import workcell
from tests import cells
from workcell import assets, cli


def call(capsys, *arguments: str) -> tuple[int, str, str]:
    """Exit status, standard output and standard error of one command."""
    status = cli.main(arguments)
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def test_list_names_every_scenario_with_a_line_about_it(capsys):
    status, out, _ = call(capsys, "list")
    assert status == 0
    lines = {
        line.split()[0]: line.split()[1:]
        for line in out.splitlines()[1:]
        if line.strip() and line[1] != " "
    }
    assert set(lines) == set(assets.scenario_names())
    assert all(lines.values())


def test_check_says_that_a_scenario_can_be_run(capsys):
    status, out, _ = call(capsys, "check", "handover")
    assert status == 0
    assert "2 arms" in out
    assert "can be run" in out


@pytest.mark.parametrize(
    ("arguments", "names"),
    [
        (("check", "handoff"), ("'handoff'", "handover")),
        (("run", "nowhere/x.toml"), ("no such scenario",)),
        (("check", "handover", "--set", "control.t_min=1"), ("control.t_min", "t_min_s")),
        (("run", "handover", "--set", "control.t_min_s=nan"), ("control.t_min_s", "finite")),
        (("check", "handover", "--set", "control.t_min_s=0.01"), ("too small", "nurse")),
        (
            ("check", "handover", "--set", "vary={'control.t_mn_s'={min=0.5,max=1.0}}"),
            ('vary."control.t_mn_s"', "no key 't_mn_s' here"),
        ),
        (
            ("check", "handover", "--set", "vary={'control.t_min_s'={min=-1.0,max=1.0}}"),
            ("control.t_min_s", "-1"),
        ),
        (("plot", "no/such/run"), ("no/such/run",)),
    ],
)
def test_refused_input_has_status_2_and_one_message(
    capsys, monkeypatch, tmp_path, arguments, names
):
    monkeypatch.chdir(tmp_path)
    status, out, err = call(capsys, *arguments)
    assert status == 2
    assert out == ""
    assert "Traceback" not in err
    for name in names:
        assert name in err


def test_the_version_is_told(capsys):
    status, out, _ = call(capsys, "--version")
    assert status == 0
    assert out.strip() == f"workcell {workcell.__version__}"


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("chek", "handover"), "no such command: 'chek'; did you mean 'check'?"),
        (("check", "handovr"), "did you mean 'handover'?"),
        (("zzz",), "no such command: 'zzz'; allowed: "),
    ],
)
def test_a_typing_error_is_answered_with_the_nearest_name(capsys, arguments, told):
    status, _, err = call(capsys, *arguments)
    assert status == 2
    assert told in err


def test_a_path_is_as_good_as_a_name_and_output_lands_where_it_is_called(
    capsys, monkeypatch, tmp_path
):
    path = cells.write(tmp_path / "elsewhere", cells.duet())
    monkeypatch.chdir(tmp_path)
    short = ("--set", "simulation.duration_s=0.4")
    status, out, err = call(capsys, "run", str(path), *short)
    assert status == 0, err
    assert (tmp_path / "runs" / "duet" / "summary.json").is_file()
    assert "duet: all expectations held" in out
    # Compiling, once after an installation, is said; progress is not.
    said = [line for line in err.splitlines() if not line.startswith("compiling")]
    assert said == [], "no progress where nobody looks"
    status, *_ = call(capsys, "run", "elsewhere/duet.toml", "--out", "here", *short)
    assert status == 0
    assert (tmp_path / "here" / "trace.parquet").is_file()


def test_an_unmet_expectation_has_status_1_and_is_shown(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    path = cells.write(tmp_path, cells.duet() | {"expect": {"completed": True}})
    status, out, _ = call(capsys, "run", str(path), "--set", "simulation.duration_s=0.4")
    assert status == 1
    assert "NOT as expected" in out
    (line,) = [line for line in out.splitlines() if "completed" in line]
    assert line.split() == ["completed", "true", "false", "NO"]


@pytest.mark.parametrize("command", sorted(cli.COMMANDS))
def test_every_command_has_help(capsys, command):
    with pytest.raises(SystemExit) as exit_:
        cli.main([command, "--help"])
    assert exit_.value.code == 0
    assert command in capsys.readouterr().out


def test_it_is_a_module_too_and_works_from_any_folder(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "workcell", "list"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"PYTHONPATH": str(Path(workcell.__file__).parents[1])},
    )
    assert "handover" in done.stdout
    assert list(tmp_path.iterdir()) == []
