"""Commands that show a run refuse what they cannot show, in a line."""

import shutil

import pytest

from tests import cells
from workcell import run as runner
from workcell.cli import main

SHORT = ("simulation.duration_s=0.2", "check.enabled=false")


@pytest.fixture(scope="module")
def without_scene(tmp_path_factory):
    folder = tmp_path_factory.mktemp("show")
    runner.run(cells.load(folder, cells.duet(), *SHORT), folder / "run")
    shutil.rmtree(folder / "run" / "scene")
    (folder / "run" / "recording.rrd").unlink()
    return folder / "run"


@pytest.mark.parametrize("command", ["replay", "film"])
def test_a_run_without_its_scene_is_refused_by_name(without_scene, command, capsys):
    assert main([command, str(without_scene)]) == 2
    said = capsys.readouterr().err
    assert "scene.xml" in said
    assert "Traceback" not in said
    assert not list(without_scene.glob("*.part*"))


def test_film_wants_a_run(capsys):
    assert main(["film"]) == 2
    assert "RUN is missing" in capsys.readouterr().err


def test_report_wants_a_run_or_a_sweep(tmp_path, capsys):
    assert main(["report", str(tmp_path / "nowhere")]) == 2
    assert "no such folder" in capsys.readouterr().err
    assert main(["report", str(tmp_path)]) == 2
    assert "holds neither trace.parquet" in capsys.readouterr().err
