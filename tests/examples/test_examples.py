"""Every example is short, runs, and shows what it says."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parents[2] / "examples").glob("*.py"))
LINES = 40


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_it_is_short_says_what_it_is_for_and_has_a_test(path):
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) < LINES
    assert text.startswith('"""')
    assert f"test_{path.stem}" in globals()


@pytest.fixture
def told(tmp_path, monkeypatch, capsys):
    """Runs an example in an empty folder and reads the numbers of each line it prints."""

    def run(name: str) -> list[list[float]]:
        monkeypatch.chdir(tmp_path)
        path = next(path for path in EXAMPLES if path.stem == name)
        runpy.run_path(str(path), run_name="__main__")
        lines = capsys.readouterr().out.splitlines()
        return [[float(x) for x in re.findall(r"-?\d+\.?\d*", line)] for line in lines]

    return run


def test_two_arms_in_mink(told):
    (free_m, free_s), (held_m, held_s) = told("two_arms_in_mink")
    assert free_m < 0.0 == free_s
    assert held_m > 0.01
    assert held_s >= 0.499


def test_velocities_behind_the_gate(told):
    lines = told("velocities_behind_the_gate")
    assert len(lines) == 2
    for free_m, gated_m in lines:
        assert free_m < -0.05
        assert gated_m > 0.005


def test_artc_in_null_space(told):
    (_, still_m, _), (_, moved_m, off_m) = told("artc_in_null_space")
    assert moved_m > still_m + 0.2
    assert off_m < 1e-4


def test_own_operator(told):
    (error_m,), (nearest_m,) = told("own_operator")
    assert error_m < 0.003
    assert 0.005 < nearest_m < 0.2


def test_trace_to_pandas(told, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "agg")
    monkeypatch.setattr("sys.argv", ["trace_to_pandas.py"])
    (percent, nearest_m), *_ = told("trace_to_pandas")
    assert 1 <= percent < 100
    assert 0.0 < nearest_m < 0.2
    assert Path("trace.png").stat().st_size > 10_000


def test_sweep_from_python(told):
    lines = told("sweep_from_python")
    assert [line[:3] for line in lines] == [[0.5, 2, 0], [1.0, 2, 0]]
    assert all(nearest_m > 0.0 for *_, nearest_m in lines)


@pytest.mark.long
def test_learn_to_wait(told, monkeypatch):
    """One round of twelve: it runs, and the best of its policies is better than the mean."""
    monkeypatch.setattr("sys.argv", ["learn_to_wait.py", "1"])
    ((_, _),) = told("learn_to_wait")
    mean, best = map(float, Path("learned.csv").read_text().splitlines()[1].split())
    assert best > mean
