"""A damaged run folder becomes a whole one, which the other commands take."""

import json
import shutil

import mujoco
import pytest

from workcell import run as runner
from workcell import scenario as scenario_file
from workcell.cli import main
from workcell.regression.restore import restore
from workcell.trace.table import JOURNAL_NAME, TRACE_NAME, load


@pytest.fixture(scope="module")
def whole(duet, tmp_path_factory):
    """A run folder as `run` makes it."""
    out = tmp_path_factory.mktemp("whole") / "run"
    runner.run(scenario_file.load(duet.scenario, ("simulation.period_s=0.02",)), out)
    return out


@pytest.fixture
def damaged(whole, tmp_path):
    """The same with a bit flipped in the middle of its trace, and without what is derived."""
    folder = shutil.copytree(whole, tmp_path / "damaged")
    path = folder / TRACE_NAME
    content = bytearray(path.read_bytes())
    content[-6] ^= 0x10  # in the length of the index, which has a copy
    path.write_bytes(content)
    (folder / runner.SUMMARY_FILE).unlink()
    (folder / runner.RECORDING_FILE).unlink()
    return folder


def test_what_is_saved_is_taken_by_the_other_commands(whole, damaged, capsys):
    assert main(["compare", str(damaged), str(whole)]) == 2
    assert main(["salvage", str(damaged)]) == 0
    saved = damaged / "salvaged"
    assert "250 rows" in " ".join(capsys.readouterr().out.split())
    names = {path.name for path in saved.iterdir()}
    assert names >= {"scenario.toml", "scene", TRACE_NAME, "recording.rrd", "summary.json"}
    assert load(saved).digest() == load(whole).digest()
    scenario = (saved / runner.SCENARIO_FILE).read_text()
    assert scenario == (whole / runner.SCENARIO_FILE).read_text()
    assert main(["compare", str(saved), str(whole)]) == 0
    assert main(["plot", str(saved)]) == 0
    assert (saved / "figures" / "figure3.png").is_file()
    summary = json.loads((saved / runner.SUMMARY_FILE).read_text())
    assert summary["held"] is False
    assert summary["metrics"]["fault"].startswith("salvaged: 250 rows")
    assert "trace.index" in summary["salvaged"]["losses"][0]


def test_a_damaged_scene_is_composed_anew(whole, damaged):
    (damaged / runner.SCENE_FOLDER / runner.SCENE_FILE).write_text("<mujoco>")
    saved = restore(damaged, damaged.with_name("saved"))
    scene = damaged.with_name("saved") / runner.SCENE_FOLDER / runner.SCENE_FILE
    assert mujoco.MjModel.from_xml_path(str(scene)).nq == load(whole).layout.nq
    assert any("scene" in loss for loss in saved.losses)
    assert saved.recording is not None


def test_without_a_row_there_is_no_run_folder(damaged):
    (damaged / TRACE_NAME).write_bytes(b"nothing")
    (damaged / "trace.index").unlink()
    saved = restore(damaged, damaged.with_name("saved"))
    assert saved.trace is None
    assert not (damaged.with_name("saved") / runner.SUMMARY_FILE).exists()


def test_a_killed_run_keeps_nothing_of_the_run_before_it(duet, whole, tmp_path, monkeypatch):
    """The folder is used again, and the second run dies in its loop."""
    out = shutil.copytree(whole, tmp_path / "run")
    (out / "report.html").write_text("of the first run")

    def die(*arguments, **options):
        raise SystemExit("killed")

    monkeypatch.setattr(runner, "conclude", die)
    scenario = scenario_file.load(
        duet.scenario, ("simulation.period_s=0.02", "simulation.duration_s=0.5")
    )
    with pytest.raises(SystemExit):
        runner.run(scenario, out)
    left = {path.name for path in out.iterdir()}
    assert not left & {"summary.json", "recording.rrd", "report.html", JOURNAL_NAME}
    assert len(load(out)) == 25
