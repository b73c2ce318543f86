"""A strategy in a package of its own is found once its wheel is installed, raced, and reproduced."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from workcell.trace.table import load

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "examples" / "own_package"
KINEMATIC = (
    "--set", "simulation.plant=kinematic", "--set", "simulation.period_s=0.02",
    "--set", "check.enabled=false", "--set", "expect={contacts_by_support={max=0}}",
)  # fmt: skip


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """Where the example's wheel is installed, by pip and without a network."""
    folder = tmp_path_factory.mktemp("package")
    python(PACKAGE, "hatchling", "build", "--target", "wheel", "--directory", str(folder))
    (wheel,) = folder.glob("*.whl")
    wishes = ("--no-deps", "--no-index", "--quiet", "--target", str(folder / "site"))
    python(folder, "pip", "install", *wishes, str(wheel))
    return folder / "site"


def python(cwd: Path, *arguments: str, path: tuple[Path, ...] = ()) -> str:
    """What a module run by this interpreter says; it has to end well."""
    done = subprocess.run(
        [sys.executable, "-m", *arguments],
        cwd=cwd,
        env=os.environ
        | {"PYTHONPATH": os.pathsep.join(map(str, [*path, ROOT])), "WORKCELL_PLUGINS": ""},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_its_strategy_is_short():
    assert len((PACKAGE / "unhurried.py").read_text(encoding="utf-8").splitlines()) <= 40


@pytest.mark.long
def test_it_is_listed_raced_run_and_reproduced(site, tmp_path):
    listed = python(tmp_path, "workcell", "plugins", path=(site,))
    assert "unhurried-strategy" in listed
    race = ("race", "planar_crossing", "--strategies", "unhurried,ttc", "--runs", "2")
    page = python(tmp_path, "workcell", *race, "--workers", "2", path=(site,))
    assert "| `unhurried` |" in page
    rows = [line.split("|") for line in page.splitlines() if line.startswith("| `")]
    assert {row[-2].strip() for row in rows} == {"0"}  # faults
    chosen = ("--set", "control.strategy=unhurried", *KINEMATIC)
    python(tmp_path, "workcell", "run", "planar_crossing", *chosen, path=(site,))
    made = tmp_path / "runs" / "planar_crossing"
    summary = json.loads((made / "summary.json").read_text())
    assert summary["versions"]["strategy unhurried"] == "unhurried-strategy 0.1.0"
    python(tmp_path, "workcell", "reproduce", str(made), "--closed-loop", path=(site,))
    python(tmp_path, "workcell", "reproduce", str(made), "--open-loop", path=(site,))
    # The same class from its file, with nothing installed, moves the arms alike.
    by_file = ("--plugin", str(PACKAGE / "unhurried.py"), "--out", "by_file")
    python(tmp_path, "workcell", "run", "planar_crossing", *chosen, *by_file)
    one, other = load(made), load(tmp_path / "by_file")
    assert (one["plant_qpos"] == other["plant_qpos"]).all()
    assert (one["nurse.scale"] < 1.0).any()


@pytest.mark.long
def test_where_it_is_not_installed_its_name_is_unknown(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "workcell", "check", "planar_crossing", "--set",
         "control.strategy=unhurried"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT), "WORKCELL_PLUGINS": ""},
        capture_output=True,
        text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert "unknown strategy 'unhurried'; known here: " in done.stderr
