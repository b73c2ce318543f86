"""The report of a sweep: rates, distributions, and worst runs that can be made again."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tests.study.staged import Here
from tests.study.test_sweep import scenario
from workcell.cli import main
from workcell.study import page
from workcell.study.sweep import plan, sweep


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("sweep")
    what = plan(scenario(folder), runs=2, seed=7)
    assert sweep(what, folder / "out", Here(), ahead=2)
    return folder / "out"


def test_the_page_has_rates_distributions_and_the_worst_run_with_its_command(out: Path):
    """The runs end too early to be a success, so that each is a failure with a folder of its own."""
    assert main(["report", str(out)]) == 0
    text = (out / "report.html").read_text(encoding="utf-8")
    assert len(text) < 3_000_000
    assert "0 of 2 (below" in text
    (content,) = re.findall(r'data-figure="figure1">(.*?)</script>', text, flags=re.S)
    assert len(json.loads(content)["data"]) == len(page.QUANTITIES)
    scenario_file = out / "failures" / "00000" / "scenario.toml"
    assert f"workcell run {scenario_file}" in text
    assert scenario_file.is_file()


def test_a_worst_run_that_was_not_kept_is_made_again(out: Path):
    row = pq.read_table(out / "runs.parquet").to_pylist()[1]
    (out / "failures" / "00001").rename(out / "failures" / "elsewhere")
    asked = json.loads((out / "sweep.json").read_text())
    folder = page._folder(row, asked, out)
    assert folder == out / "worst" / "00001"
    kept = (out / "failures" / "elsewhere" / "scenario.toml").read_text()
    assert (folder / "scenario.toml").read_text() == kept
    asked["content_sha256"] = {"": "another"}
    (folder / "summary.json").unlink()
    with pytest.raises(page.InputError, match="has changed since the sweep"):
        page._folder(row, asked, out)
