"""The blocks of the pages that need something around them: a run, a cell, a controller of one's own."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from tests import cells
from tests.guard.cell import ARMS, CLEAR_POSE, write_scene
from workcell import assets, plugins
from workcell import run as runner
from workcell import scenario as scenario_file
from workcell.guard import Exemption
from workcell.regression import reference as regression

ROOT = Path(__file__).parents[1]


def blocks(page: str, language: str) -> list[str]:
    text = (ROOT / page).read_text(encoding="utf-8")
    return re.findall(rf"```{language}\n(.*?)```", text, flags=re.S)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with `runs/handover` and `runs/first`, as the pages speak of them."""
    folder = tmp_path_factory.mktemp("pages")
    content = cells.duet()
    content["simulation"] |= {"period_s": 0.002, "duration_s": 8.1}
    content["check"] = {"enabled": False}
    runner.run(cells.load(folder, content), folder / "runs" / "handover")
    (folder / "runs" / "first").symlink_to("handover")
    return folder


@pytest.mark.parametrize(
    ("page", "number", "printed"),
    [
        ("docs/trace.md", 0, r"\('nurse/link3_capsule|\('surgeon/link3_capsule"),
        ("docs/tutorial.md", 0, r"slowed for \d+\.\d s, smallest distance 0\.0\d\d m"),
        ("docs/regression.md", 0, ""),
    ],
)
def test_blocks_that_read_a_run_read_it(runs, monkeypatch, capsys, page, number, printed):
    monkeypatch.chdir(runs)
    exec(blocks(page, "python")[number], {})
    assert re.search(printed, capsys.readouterr().out)


def test_a_controller_of_ones_own_is_held_against_a_reference(monkeypatch, capsys):
    monkeypatch.chdir(ROOT)
    reference = regression.load(ROOT / "tests/replay/references/handover")
    wanted = reference.rows("open").values["command_rad_s"]
    standing = np.zeros(wanted.shape[1])
    exec(blocks("docs/regression.md", "python")[1], {"my_controller": lambda q, v: standing})
    assert "first differing tick: " in capsys.readouterr().out


def test_a_strategy_of_ones_own_drives_its_arm(tmp_path, monkeypatch):
    (code,) = blocks("docs/strategies.md", "python")
    (tmp_path / "careful.py").write_text(code, encoding="utf-8")
    monkeypatch.setenv(plugins.FILES_VARIABLE, "")
    plugins.use_files([tmp_path / "careful.py"])
    short = ("simulation.duration_s=0.3", "check.enabled=false", "expect={}")
    loaded = scenario_file.load("planar_crossing", ("control.strategy=careful", *short))
    summary = runner.run(loaded, tmp_path / "run")
    assert summary["held"]


def test_the_final_check_can_be_used_by_itself(tmp_path):
    loop, exemption = blocks("docs/final_check.md", "python")
    names = {
        "scene_xml": write_scene(tmp_path),
        "n_ticks": 10,
        "qpos": CLEAR_POSE,
        "command": np.full(10, 0.1),
        "acceleration_limits": np.full(10, 2.0),
    }
    exec(loop, names)
    assert set(ARMS) == set(names["settings"].arms)
    assert not names["latch"].latched
    exec(exemption, {"Exemption": Exemption})


@pytest.mark.parametrize("page", ["final_check", "studies", "teleop"])
def test_tables_of_a_scenario_fit_into_a_shipped_one(page, tmp_path):
    content = tomllib.loads(assets.scenario_file("handover").read_text(encoding="utf-8"))
    for block in blocks(f"docs/{page}.md", "toml"):
        for key, table in tomllib.loads(block).items():
            content[key] = content.get(key, {}) | table if isinstance(table, dict) else table
    loaded = scenario_file.Scenario.model_validate({"name": "page", **content})
    assert loaded.model_dump()
