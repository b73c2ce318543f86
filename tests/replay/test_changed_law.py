"""A law that is changed in a copy of the package is what that copy runs, and a replay says where behaviour parted."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.long
def test_a_pairwise_factor_times_1_3_is_noticed(tmp_path):
    copy = tmp_path / "copy"
    for part in ("workcell", "mjcf", "scenarios"):
        shutil.copytree(ROOT / part, copy / part, ignore=shutil.ignore_patterns("__pycache__"))

    def command(where: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "workcell", *arguments],
            cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(where)},
            capture_output=True, text=True, check=False,
        )  # fmt: skip

    settings = ("simulation.duration_s=6", "check.enabled=false", "expect={}")
    ran = command(
        copy, "run", "planar_crossing", "--out", "run", *(w for s in settings for w in ("--set", s))
    )
    assert ran.returncode == 0, ran.stderr
    same = command(copy, "reproduce", "run", "--open-loop")
    assert same.returncode == 0, same.stdout + same.stderr
    law = copy / "workcell" / "control" / "laws" / "speed_scale.py"
    text = law.read_text(encoding="utf-8")
    line = "    factor = 0.0 if least <= 0.0 else min(least, 1.0)\n"
    assert text.count(line) == 1
    law.write_text(text.replace(line, line + "    factor = min(1.0, 1.3 * factor)\n"))
    changed = command(copy, "reproduce", "run", "--open-loop")
    assert changed.returncode == 1, changed.stdout + changed.stderr
    assert "differs" in changed.stdout
    assert "scaling" in changed.stdout
