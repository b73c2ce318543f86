"""What the README claims is true: its commands, its scenario, its snippet, its pictures."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from workcell import assets
from workcell import run as runner
from workcell import scenario as scenario_file
from workcell.cli import COMMANDS

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def block(language: str) -> str:
    (found,) = re.findall(rf"```{language}\n(.*?)```", README, flags=re.S)
    return found


def test_the_table_of_commands_is_complete():
    assert set(re.findall(r"^\| `workcell ([a-z-]+)", README, flags=re.M)) == set(COMMANDS)


def test_every_shipped_scenario_has_its_sentence():
    rows = re.findall(r"^\| (`[a-z_`, ]+`) \| [A-Z].*\. \|$", README, flags=re.M)
    told = [name for row in rows for name in re.findall(r"`([a-z_]+)`", row)]
    assert sorted(told) == sorted(assets.scenario_names())


def test_its_scenario_runs_and_holds_and_its_snippet_reads_it(tmp_path, monkeypatch, capsys):
    (tmp_path / "example.toml").write_text(block("toml"), encoding="utf-8")
    summary = runner.run(scenario_file.load(tmp_path / "example.toml"), tmp_path / "runs/handover")
    assert summary["expectations"]["completed"]["held"], summary["expectations"]
    assert summary["held"], summary["expectations"]
    monkeypatch.chdir(tmp_path)
    exec(block("python"), {})
    time_and_ttc, pair = capsys.readouterr().out.splitlines()
    assert float(time_and_ttc.split()[1]) == pytest.approx(1.0, abs=0.1)
    assert "surgeon/link3_capsule" in pair


def test_pictures_are_there_and_small():
    pictures = re.findall(r"!\[.+?\]\((.+?)\)", README)
    assert len(pictures) == 5
    for picture in pictures:
        most = 1_500_000 if picture.endswith(".webp") else 200_000
        assert 10_000 < (ROOT / picture).stat().st_size < most


def test_the_key_that_switches_the_check_off_exists():
    (override,) = re.findall(r"--set (check\.\S+=\w+)", README)
    assert scenario_file.load("handover", (override,)).check.enabled is False
