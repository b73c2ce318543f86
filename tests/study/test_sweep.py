"""A sweep makes what was planned, the same on any workers, keeps what is done, and judges honestly."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests import cells
from tests.study.staged import Here, Staged
from workcell import run as runner
from workcell import scenario as scenario_file
from workcell.errors import InputError
from workcell.study import report
from workcell.study.folder import JOURNAL_FILE, PLAN_FILE, TABLE_FILE
from workcell.study.outcome import AFTER_DONE_S, VOLATILE
from workcell.study.sweep import Plan, plan, sweep
from workcell.study.workers import LocalWorkers, WorkerDied
from workcell.trace.table import load

VARY: dict[str, Any] = {
    "control.t_min_s": {"min": 0.9, "max": 1.2},
    "arm.nurse.home_rad": {"plus_minus": 0.05},
    "simulation.position_noise_rad": {"min": 1e-6, "max": 1e-4, "log": True},
    "simulation.seed": {"min": 0, "max": 1000},
}


def scenario(folder: Path, duration_s: float = 0.2, **content: Any) -> str:
    what = {**cells.duet(), "vary": VARY, **content}
    what["simulation"] = {"plant": "kinematic", "period_s": 0.01, "duration_s": duration_s}
    return str(cells.write(folder, what))


def rows(out: Path) -> list[dict[str, Any]]:
    return [
        {key: value for key, value in row.items() if key not in VOLATILE}
        for row in pq.read_table(out / "runs.parquet").to_pylist()
    ]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Plan, Path]:
    """Two variations under two settings, made in this process; too short to be a success."""
    folder = tmp_path_factory.mktemp("made")
    what = plan(scenario(folder), runs=2, seed=7, compare=("control.variant=static,relative",))
    assert sweep(what, folder / "out", Here(), ahead=2)
    return what, folder / "out"


def test_rows_are_the_same_on_any_number_of_workers(made: tuple[Plan, Path], tmp_path: Path):
    what, out = made
    workers = LocalWorkers(2)
    try:
        assert sweep(what, tmp_path / "out", workers, ahead=4)
    finally:
        workers.shutdown(cancel_futures=True)
    assert rows(tmp_path / "out") == rows(out)
    # In the order of runs, and of settings as they were asked for: the first is what others are compared to.
    assert [(row["run"], row["setting"].rpartition("=")[2]) for row in rows(out)] == [
        (0, "static"),
        (0, "relative"),
        (1, "static"),
        (1, "relative"),
    ]


def test_settings_share_their_variations_and_runs_do_not(made: tuple[Plan, Path]):
    by_run: dict[int, set[str]] = {}
    for row in rows(made[1]):
        assert row["status"] == "ran"
        drawn = json.dumps({key: value for key, value in row.items() if key.startswith("vary.")})
        by_run.setdefault(row["run"], set()).add(drawn)
    assert {run: len(draws) for run, draws in by_run.items()} == {0: 1, 1: 1}
    assert len(set.union(*by_run.values())) == 2


def test_a_failure_is_kept_with_the_command_that_makes_it_again(
    made: tuple[Plan, Path], tmp_path: Path
):
    folder = made[1] / "failures" / "00001_control.variant-static"
    assert {"scenario.toml", "trace.parquet", "summary.json", "reproduce.txt"} <= {
        path.name for path in folder.iterdir()
    }
    words = (folder / "reproduce.txt").read_text().split()
    assert words[:2] == ["workcell", "run"]
    again = scenario_file.load(words[2])
    cell = runner.prepare(again, tmp_path / "scene")
    runner.simulate(cell, tmp_path)
    first, second = load(folder), load(tmp_path)
    assert len(first) == len(second) == 20
    assert first["command_rad_s"].tolist() == second["command_rad_s"].tolist()


def test_what_is_done_is_kept_when_stopped_and_resume_makes_the_rest(tmp_path: Path):
    def stop_at_five(run: int, setting: str, _: object) -> dict[str, Any]:
        if run == 5:
            raise KeyboardInterrupt
        return {"smallest_m": float(run)}

    what, out = plan(scenario(tmp_path), runs=8, seed=1), tmp_path / "out"
    assert not sweep(what, out, Staged(stop_at_five), ahead=1)
    assert [row["run"] for row in rows(out)] == [0, 1, 2, 3, 4]
    with pytest.raises(InputError, match="holds a sweep; say --resume"):
        sweep(what, out, Staged(stop_at_five), ahead=1)
    # A kill leaves half a line, which must neither count nor spoil the next one.
    with (out / JOURNAL_FILE).open("a") as journal:
        journal.write('{"run": 5, "sett')
    rest = Staged(lambda run, *_: {"smallest_m": float(run)})
    assert sweep(what, out, rest, ahead=1, resume=True)
    assert rest.made == [(5, ""), (6, ""), (7, "")]
    assert [row["smallest_m"] for row in rows(out)] == [float(k) for k in range(8)]
    with pytest.raises(InputError, match="differs from what is asked now in seed"):
        sweep(plan(scenario(tmp_path), runs=8, seed=2), out, rest, ahead=1, resume=True)
    more = Staged(lambda *_: {})
    assert sweep(plan(scenario(tmp_path), runs=9, seed=1), out, more, ahead=1, resume=True)
    assert more.made == [(8, "")]


@pytest.mark.parametrize(
    ("name", "content", "word"),
    [
        (PLAN_FILE, "{", "holds no sweep"),
        (PLAN_FILE, "[]", "allowed is a JSON object"),
        (PLAN_FILE, "{}", "scenario, set, compare"),
        (JOURNAL_FILE, '{"run": 0}\n', "line 1 is damaged"),
        (JOURNAL_FILE, "\x00\n", "line 1 is damaged"),
        (JOURNAL_FILE, None, "the journal of the sweep cannot be read"),
    ],
)
def test_a_damaged_folder_is_refused_by_file_and_line(tmp_path, name, content, word):
    what, out = plan(scenario(tmp_path), runs=1, seed=1), tmp_path / "out"
    sweep(what, out, Staged(lambda *_: {}), ahead=1)
    (out / name).unlink()
    if content is not None:
        (out / name).write_text(content)
    with pytest.raises(InputError, match=re.escape(word)) as refusal:
        sweep(what, out, Staged(lambda *_: {}), ahead=1, resume=True)
    assert name in str(refusal.value)


def test_a_damaged_table_is_refused_by_name(tmp_path):
    path = tmp_path / TABLE_FILE
    with pytest.raises(InputError, match="cannot be read"):
        report.read(tmp_path)
    path.write_bytes(b"PAR1")
    with pytest.raises(InputError, match="cannot be read"):
        report.read(tmp_path)
    pq.write_table(pa.table({"run": [1]}), path)
    with pytest.raises(InputError, match="setting, status"):
        report.read(tmp_path)


def test_dead_workers_and_defects_cost_their_runs_and_are_made_again(tmp_path: Path):
    def mishaps(run: int, *_: object) -> dict[str, Any]:
        if run == 1:
            raise WorkerDied("worker 0 died: killed")
        if run == 2:
            raise ZeroDivisionError("a defect")
        return {}

    what, out = plan(scenario(tmp_path), runs=4, seed=1), tmp_path / "out"
    assert sweep(what, out, Staged(mishaps), ahead=2)
    assert [row["status"] for row in rows(out)] == ["ran", "died", "error", "ran"]
    assert "ZeroDivisionError: a defect" in rows(out)[2]["reason"]
    assert not report.all_succeeded(out)
    again = Staged(lambda *_: {})
    assert sweep(what, out, again, ahead=2, resume=True)
    assert sorted(again.made) == [(1, ""), (2, "")]
    assert report.all_succeeded(out)


def test_values_that_do_not_go_together_are_a_row_and_not_a_run(tmp_path: Path):
    """The file allows either speed; only the cell can tell that nobody brakes from the second within t_min."""
    path = scenario(tmp_path, vary={"arm.nurse.job.0.speed_m_s": {"choices": [0.15, 5.0]}})
    out = tmp_path / "out"
    sweep(plan(path, runs=4, seed=0), out, Here(), ahead=1)
    refused = [row for row in rows(out) if row["status"] == "refused"]
    assert 0 < len(refused) < 4
    assert all("too small for arm nurse to brake" in row["reason"] for row in refused)
    assert len(report.made(rows(out))) == 4 - len(refused)


def test_the_page_counts_what_happened(tmp_path: Path):
    def half_of_them_touch(run: int, setting: str, _: object) -> dict[str, Any]:
        touch = setting.endswith("static") and run % 2 == 0
        return {
            "success": not touch,
            "contact_cause": "both" if touch else "",
            "smallest_m": 0.01 if touch else 0.02,
        }

    compare = ("control.variant=relative,static",)
    what, out = plan(scenario(tmp_path), runs=40, seed=0, compare=compare), tmp_path / "out"
    sweep(what, out, Staged(half_of_them_touch), ahead=3)
    page = report.conclude(out, "the command").read_text(encoding="utf-8")
    assert "    the command\n" in page
    assert "contact, support arm had a part | 0 of 40 (below 7.22 %) | 20 of 40, 50 %" in page
    assert "smallest distance, mm | 20 (20 to 20) | 15 (10 to 20)" in page
    assert "| smallest distance, mm | -5 (-6.62 to -3.38) * |" in page
    assert (out / "figures" / "rates.png").stat().st_size > 1000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"runs": 0}, "--runs 0: allowed is 1 or more"),
        ({"seed": -1}, "--seed -1: allowed is 0 or more"),
        ({"compare": ("control.criterion",)}, "allowed is KEY=VALUE,VALUE"),
        (
            {"compare": ("control.criterion=artc,neither",)},
            "control.criterion: unknown criterion 'neither'; known here: armd, artc, ",
        ),
        ({"compare": ("control.t_min_s=1.0,1.1",)}, 'it is also varied by vary."control.t_min_s"'),
    ],
)
def test_a_plan_that_cannot_be_made_is_refused(
    tmp_path: Path, arguments: dict[str, Any], message: str
):
    with pytest.raises(InputError) as refusal:
        plan(scenario(tmp_path), **{"runs": 1, "seed": 0, **arguments})
    assert message in str(refusal.value)


def test_a_scenario_without_variations_is_refused(tmp_path: Path):
    with pytest.raises(InputError, match=r"has no \[vary\] table"):
        plan(scenario(tmp_path, vary={}), runs=1, seed=0)


def test_a_run_ends_soon_after_its_last_job(tmp_path: Path):
    quick = {"kind": "wait", "duration_s": 0.3}
    content = cells.duet()
    content["arm"][1]["job"] = [quick]
    content["simulation"] = {"plant": "kinematic", "period_s": 0.01, "duration_s": 4.0}
    content |= {"check": {"enabled": False}, "vary": VARY}
    what, out = plan(str(cells.write(tmp_path, content)), runs=1, seed=0), tmp_path / "out"
    assert sweep(what, out, Here(), ahead=1)
    [row] = rows(out)
    assert row["success"]
    assert row["simulated_s"] == pytest.approx(row["done_s"] + AFTER_DONE_S, abs=0.03)
