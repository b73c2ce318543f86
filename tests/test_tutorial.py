"""The tutorial's blocks, typed one after the other into an empty folder, do what it says."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "tutorial.md"
SHOWN = "workcell replay "
"""Opens the viewer and waits until a person closes it."""


def typed() -> Iterator[list[str]]:
    """The page's commands, and its Python blocks as commands, in the order of the page."""
    for language, block in re.findall(
        r"```(\w*)\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.S
    ):
        if language == "python":
            yield ["-c", block]
            continue
        for line in block.splitlines():
            assert line.startswith("workcell "), line
            if not line.startswith(SHOWN):
                yield ["-m", *shlex.split(line)]


def test_it_ends_in_a_race_of_what_it_has_written():
    commands = list(typed())
    assert ["-m", "workcell", "new", "strategy", "mine"] in commands
    assert "race" in commands[-1]


@pytest.mark.long
def test_from_an_empty_folder_to_a_race(tmp_path):
    last = ""
    for command in typed():
        done = subprocess.run(
            [sys.executable, *command],
            cwd=tmp_path,
            env=os.environ | {"PYTHONPATH": str(ROOT), "WORKCELL_PLUGINS": "", "MPLBACKEND": "agg"},
            capture_output=True,
            text=True,
            check=False,
        )
        # The page says of both that they end so: two runs that differ, and a strategy that stands before the hand.
        differs = "compare" in command
        stands = "control.strategy=mine" in command
        wanted = 1 if differs or stands else 0
        assert done.returncode == wanted, f"{command}\n{done.stdout}\n{done.stderr}"
        if stands:
            assert re.search(r"completed +true +false", done.stdout)
            assert re.search(r"contact +false +false", done.stdout)
        last = done.stdout
    for strategy in ("mine", "ttc", "cbf"):
        assert f"| `{strategy}` | " in last
    assert (tmp_path / "runs" / "mine" / "summary.json").is_file()
