"""The package works from a built wheel in an empty folder: models and scenarios travel with it."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory) -> Path:
    """The wheel's content in a folder of its own, as an installer would lay it out."""
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [
            sys.executable,
            "-m",
            "hatchling",
            "build",
            "--target",
            "wheel",
            "--directory",
            str(folder),
        ],
        cwd=ROOT,
        check=True,
        capture_output=True,
    )
    (wheel,) = folder.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder / "site")
    return folder / "site"


def call(
    site: Path, cwd: Path, *arguments: str, **environment: str
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "workcell", *arguments],
        cwd=cwd,
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PYTHONPATH": str(site), **environment},
    )


@pytest.mark.long
def test_the_wheel_lists_and_runs_from_an_empty_folder(unpacked, tmp_path):
    listed = call(unpacked, tmp_path, "list")
    assert listed.returncode == 0, listed.stderr
    for scenario in (ROOT / "scenarios").glob("*.toml"):
        assert scenario.stem in listed.stdout
    short = ("--set", "simulation.duration_s=0.2", "--set", "expect={contact=false}")
    ran = call(unpacked, tmp_path, "run", "handover", *short)
    assert ran.returncode == 0, ran.stderr + ran.stdout
    scene = (tmp_path / "runs" / "handover" / "scene" / "scene.xml").read_text()
    assert "surgeon" in scene
    assert str(ROOT) not in scene


@pytest.mark.long
def test_an_installed_wheel_compiles_into_its_own_folder_or_the_users_and_runs_with_it(
    unpacked, tmp_path
):
    """Also where the package may not be written to; a run says that it compiles where nothing has been."""
    short = ("run", "handover", "--set", "simulation.duration_s=0.1", "--set", "expect={}")
    cache = {"XDG_CACHE_HOME": str(tmp_path / "cache")}

    def says_so(*command: str) -> bool:
        ran = call(unpacked, tmp_path, *command, **cache)
        assert ran.returncode == 0, ran.stderr + ran.stdout
        summary = json.loads((tmp_path / "runs" / "handover" / "summary.json").read_text())
        assert summary["versions"]["kernels"].startswith("compiled by numba")
        return "compiling the laws of a tick" in ran.stderr

    assert says_so(*short)
    assert not says_so(*short)
    done = call(unpacked, tmp_path, "compile", **cache)
    assert done.returncode == 0, done.stderr
    compiled = Path(done.stdout.strip())
    assert compiled.is_relative_to(unpacked)
    # Where the package's folder cannot be written (here, as root can write anywhere: is a file), the user's cache is used.
    shutil.rmtree(compiled.parent)
    compiled.parent.write_text("")
    done = call(unpacked, tmp_path, "compile", **cache)
    assert done.returncode == 0, done.stderr
    assert Path(done.stdout.strip()).is_relative_to(tmp_path / "cache")
    assert not says_so(*short)
