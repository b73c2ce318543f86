"""What is no file is refused before it is read without end: of a run folder, and of a folder's inside."""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path

import pytest

from tests import cells
from workcell import run as runner
from workcell import scenario as scenario_file
from workcell.errors import TraceError
from workcell.files import NoFile, read_object, read_text, require_files
from workcell.judge import judge_run
from workcell.regression.restore import restore
from workcell.run import ORIGIN_FILE, SCENE_FOLDER, SUMMARY_FILE, read_summary


def endless(path: Path, kind: str) -> Path:
    """In the place of a file, something that is read without end."""
    path.unlink(missing_ok=True)
    if kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    return path


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    """A short run's folder."""
    what = {
        **cells.duet(),
        "simulation": {"plant": "kinematic", "period_s": 0.01, "duration_s": 0.1},
    }
    folder = tmp_path_factory.mktemp("finished")
    runner.run(scenario_file.load(cells.write(folder, what)), folder / "run")
    return folder / "run"


@pytest.fixture
def run_folder(finished, tmp_path) -> Path:
    """A copy to be damaged."""
    return shutil.copytree(finished, tmp_path / "run")


@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_a_path_that_is_no_file_is_named(tmp_path, kind):
    path = endless(tmp_path / "x", kind)
    for read in (read_text, read_object):
        with pytest.raises(NoFile, match=re.escape(str(path))):
            read(path)
    with pytest.raises(NoFile, match=re.escape(str(path))):
        require_files(tmp_path)
    with pytest.raises(FileNotFoundError):
        read_text(tmp_path / "nothing")


def test_json_that_is_no_object_is_refused(tmp_path):
    (tmp_path / "x.json").write_text("[1, 2]")
    with pytest.raises(ValueError, match="holds a list; allowed is a JSON object"):
        read_object(tmp_path / "x.json")


@pytest.mark.parametrize("kind", ["pipe", "device"])
@pytest.mark.parametrize("name", [ORIGIN_FILE, SUMMARY_FILE, f"{SCENE_FOLDER}/extra.obj"])
def test_a_run_folder_is_salvaged_without_what_is_no_file(run_folder, tmp_path, kind, name):
    endless(run_folder / name, kind)
    saved = restore(run_folder, tmp_path / "saved")
    assert saved.trace is not None
    if name.startswith(SCENE_FOLDER):
        assert any("no file but a device, pipe" in loss for loss in saved.losses)
        with pytest.raises(TraceError, match="no file but a device"):
            judge_run(run_folder)
    if name == SUMMARY_FILE:
        with pytest.raises(TraceError, match="no file but a device"):
            read_summary(run_folder)
