"""A pair that the scenario ignores is held apart by nobody, and everybody is told."""

from __future__ import annotations

import numpy as np
import pytest

from tests import cells
from workcell import run
from workcell.admission import admit
from workcell.cli import main
from workcell.errors import InputError
from workcell.judge.scene import JudgedScene

TABLE = {
    "name": "table",
    "shape": "box",
    "size_m": [0.05, 0.05, 0.2],
    "position_m": [0.3, 0.5, 0.3],
}


def content(*ignore: dict) -> dict:
    """Two planar arms beside a table."""
    return cells.duet() | {"obstacle": [TABLE], "ignore": list(ignore)}


LEFT_OUT = {"pair": ["nurse/link2", "surgeon/link3"], "reason": "they carry foam"}


def test_neither_controller_nor_final_check_nor_judge_holds_it_apart(tmp_path):
    loaded = cells.load(tmp_path, content(LEFT_OUT))
    admitted = admit(loaded, tmp_path / "scene")
    pairs, model = admitted.cell.pairs, admitted.cell.model
    bodies = [{model.body(model.geom_bodyid[g]).name for g in pair} for pair in pairs.geoms]
    assert {"nurse/link2", "surgeon/link3"} not in bodies
    assert {reason for *_, reason in pairs.ignored} == {"ignored: they carry foam"}
    checker = admitted.checker
    assert checker is not None
    pieces = checker.geometry.pieces
    for i, j in np.argwhere(checker.table.watched):
        assert {pieces[i].body_name, pieces[j].body_name} != {"nurse/link2", "surgeon/link3"}
    assert any(row.reason == "ignored: they carry foam" for row in checker.table.left_out)
    dofs = {arm.name: arm.dofs for arm in admitted.cell.arms}
    judged = JudgedScene(model, loaded.model_dump(), dofs).solid_pairs
    whole = JudgedScene(model, loaded.model_dump() | {"ignore": []}, dofs).solid_pairs
    assert len(whole) - len(judged) > 0


def test_an_obstacle_is_named_by_its_geom_and_no_other_is_meant(tmp_path):
    entry = {"pair": ["nurse/link3", "table"], "reason": "soft"}
    cell = cells.build(tmp_path, content(entry))
    gone = {tuple(sorted(pair[:2])) for pair in cell.pairs.ignored}
    assert gone
    assert all("table" in pair and any("nurse/link3" in n for n in pair) for pair in gone)


def test_a_part_that_is_not_there_is_refused(tmp_path):
    entry = {"pair": ["nurse/link9", "table"], "reason": "x"}
    words = "ignore.0.pair: no body or geom of the scene is named 'nurse/link9'.*nurse/link"
    with pytest.raises(InputError, match=words):
        cells.build(tmp_path, content(entry))


def test_the_final_check_can_hold_apart_what_the_controller_ignores(tmp_path):
    loaded = cells.load(tmp_path, content(LEFT_OUT | {"final_check": True}))
    admitted = admit(loaded, tmp_path / "scene")
    assert admitted.cell.pairs.ignored
    assert admitted.checker is not None
    assert not any("ignored" in row.reason for row in admitted.checker.table.left_out)


def test_a_run_says_it(tmp_path, capsys):
    path = cells.write(tmp_path, content(LEFT_OUT))
    out = tmp_path / "run"
    main(["run", str(path), "--out", str(out), "--set", "simulation.duration_s=0.1"])
    assert "you answer for it" in capsys.readouterr().err
    summary = run.read_summary(out)
    assert summary is not None
    assert {reason for *_, reason in summary["ignored_pairs"]} == {"ignored: they carry foam"}
