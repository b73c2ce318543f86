"""What people type: exit status, the words on the terminal, the files."""

import json
import shutil

import pytest

from tests import cells
from tests.replay.conftest import duet_content
from tests.view.viewer import NoDriver, look
from workcell.cli import main
from workcell.errors import InputError
from workcell.regression import reference as regression
from workcell.regression.bless import bless
from workcell.regression.compare import compare
from workcell.regression.excerpt import excerpt
from workcell.regression.recording_of_both import record
from workcell.trace.table import load


@pytest.fixture(scope="module")
def other(duet, tmp_path_factory):
    """The same scenario, slower."""
    out = tmp_path_factory.mktemp("other") / "run"
    arguments = ["--set", "control.t_min_s=1.5", "--set", "simulation.duration_s=2.0"]
    main(["run", str(duet.scenario), "--out", str(out), *arguments])
    return out


def said(text):
    """As one line: the terminal may have wrapped it."""
    return " ".join(text.split())


def test_compare_answers_by_its_exit_status(duet, other, tmp_path, capsys):
    run = shutil.copytree(duet.trace.source.parent, tmp_path / "run")
    assert main(["compare", str(run), str(duet.trace.source), "--ticks"]) == 0
    assert "same over 250 compared ticks" in capsys.readouterr().out
    assert main(["compare", str(run), str(duet.references / "duet")]) == 0
    assert main(["compare", str(run), str(other), "--ticks"]) == 2
    assert "control.t_min_s 1.0 | 1.5" in said(capsys.readouterr().out)
    assert main(["compare", str(run), str(tmp_path)]) == 2
    assert main(["compare", str(run), str(other), "--other-settings", "--plot"]) == 1
    out = capsys.readouterr().out
    assert "250 ticks instead of 100" in said(out)
    assert (run / "comparison.png").stat().st_size > 10_000
    everything = (run / "comparison.txt").read_text()
    assert "wanted_rad_s" in everything
    assert len(everything) > len(out) / 2


def test_compare_says_in_words_what_differs(duet, other, capsys):
    """The other run has another t_min and 2 s instead of 5 s: both are named, and what they do."""
    assert main(["compare", str(other), str(duet.trace.source)]) == 1
    out = capsys.readouterr().out
    assert all(len(line) <= 80 for line in out.splitlines())
    words = said(out)
    assert "control.t_min_s 1.5 1.0" in words
    assert "run 2 s 5 s 3 s shorter" in words
    assert main(["compare", str(duet.trace.source), str(duet.trace.source)]) == 0
    assert "no difference that a person would notice" in said(capsys.readouterr().out)


@pytest.mark.parametrize("loop", ["--open-loop", "--closed-loop"])
def test_a_run_done_again_is_the_same(duet, tmp_path, loop):
    assert main(["reproduce", str(duet.trace.source), loop, "--out", str(tmp_path / "again")]) == 0
    assert (tmp_path / "again" / "comparison.txt").is_file()


def test_a_run_of_which_the_judge_says_something_else_than_its_trace_is_reproduced(tmp_path):
    """The surgeon touches a nurse that never yields: to the judge that is not the nurse's time to collision."""
    settings = (
        "control.strategy=paper_scaling", "simulation.plant=kinematic", "simulation.period_s=0.02",
        "simulation.duration_s=5.0", "check.enabled=false",
        "expect={contacts_by_support={max=0}}",
    )  # fmt: skip
    run = tmp_path / "run"
    overrides = [word for setting in settings for word in ("--set", setting)]
    assert main(["run", "planar_crossing", "--out", str(run), *overrides]) == 0
    metrics = json.loads((run / "summary.json").read_text())["metrics"]
    own = "smallest_ttc_command_own_s"
    assert metrics[own] != regression.metrics_of(load(run))[own]
    assert main(["reproduce", str(run), "--closed-loop"]) == 0


def test_reproduce_wants_one_loop_and_its_old_name_says_the_new_one(duet, capsys):
    assert main(["reproduce", str(duet.trace.source)]) == 2
    assert "workcell reproduce" not in said(capsys.readouterr().err)
    assert main(["rerun", str(duet.trace.source)]) == 2
    err = said(capsys.readouterr().err)
    assert "is called `workcell reproduce` now" in err
    assert "exactly one of --open-loop and --closed-loop" in err


def test_salvage_of_a_whole_run_loses_nothing(duet, tmp_path, capsys):
    folder = duet.trace.source.parent
    assert main(["salvage", str(folder), "--out", str(tmp_path / "saved")]) == 0
    assert "lost" not in capsys.readouterr().out


def test_blessing_takes_a_reason_and_kept_expectations(duet, tmp_path):
    with pytest.raises(InputError, match="REASON"):
        bless(str(duet.scenario), tmp_path, " ", out=tmp_path)
    content = duet_content()
    content["simulation"]["duration_s"] = 0.2
    for expect, message in (
        ({}, "nothing is expected"),
        ({"nurse.scaled_ticks": {"min": 100}}, "not blessed.* nurse.scaled_ticks is 0"),
    ):
        file = cells.write(tmp_path, content | {"expect": expect})
        with pytest.raises(InputError, match=message):
            bless(str(file), tmp_path / "references", "why not", out=tmp_path / "out")
    assert not (tmp_path / "references").exists(), "a refusal leaves no trace"


def test_blessing_again_logs_what_changed(duet, tmp_path):
    references = shutil.copytree(duet.references, tmp_path / "references")
    content = duet_content() | {"control": {"t_min_s": 0.8}}
    file = cells.write(tmp_path, content)
    bless(str(file), references, "bolder", out=tmp_path / "out")
    log = (references / "LOG.md").read_text().split("\n## ")
    assert "first" in log[1]
    assert "bolder" in log[2]
    was = json.loads((duet.references / "duet" / "reference.json").read_text())
    ticks = was["metrics"]["nurse.scaled_ticks"]
    assert f"| nurse.scaled_ticks | {ticks} | " in log[2]
    assert "| ticks |" not in log[2], "what did not change is left out"
    assert regression.load(references / "duet").overrides == ("simulation.period_s=0.02",)


def test_a_broken_expectation_shows_in_the_closed_loop(duet, tmp_path):
    expect = {
        "nurse.scaled_ticks": type(next(iter(duet.reference.scenario.expect.values())))(min=999)
    }
    result = regression.check_closed_loop(duet.reference, tmp_path, expect=expect)
    assert result.unmet[0].startswith("nurse.scaled_ticks is")
    assert not result.same
    assert result.comparison.kind == "same"


def test_both_runs_are_curves_of_one_recording(duet, other, tmp_path):
    run, reference = excerpt(duet.trace), excerpt(load(other))
    result = compare(run, reference, other_settings=True)
    recording = record(run, reference, result, tmp_path / "both.rrd")
    try:
        sight = look(recording, tmp_path / "both.png", 1.0)
    except NoDriver as error:
        pytest.skip(f"no Vulkan driver to draw with: {error}")
    wanted = [d.column for d in result.differences if d.largest is not None][:8]
    assert sight.views == {*wanted, "Verdict"}
    assert sight.problems == []
    assert sight.errors == []
