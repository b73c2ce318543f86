"""`place` finds where an arm must stand, changes nothing else of the file, and what it finds can be run."""

from __future__ import annotations

import numpy as np
import pytest

from tests import cells
from workcell import scenario
from workcell.admission import admit
from workcell.cli import main
from workcell.errors import InputError
from workcell.scenario.rewrite import rewrite
from workcell.study.place import place
from workcell.study.rehearsal import rehearse


def far_apart() -> dict:
    """The duet with a nurse that cannot reach the surgeon's tool from where it stands."""
    content = cells.duet()
    content["arm"][1]["base_position_m"] = [-1.4, 0.3, 0.0]
    return content


def test_a_rehearsal_says_what_is_out_of_reach_and_what_lacks_room(tmp_path):
    cell = cells.build(tmp_path, far_apart())
    found = rehearse(cell, cell.arms[1], 0.02)
    assert found.missed_m > 0.05
    assert "meet" in found.missed_at
    assert not found.fits
    assert rehearse(cell, cell.arms[0], 0.02).fits
    near = cells.build(tmp_path / "near", cells.duet())
    assert rehearse(near, near.arms[1], 0.02).missed_m == 0.0
    crowded = rehearse(near, near.arms[1], 0.3)
    assert crowded.near_pair is not None
    assert 0.0 < crowded.near_m < 0.3


def test_a_rehearsal_changes_nothing_of_the_cell(tmp_path):
    cell = cells.build(tmp_path, far_apart())
    before = cell.model.body_pos.copy(), [arm.home_rad.copy() for arm in cell.arms]
    assert rehearse(cell, cell.arms[1], 0.02) == rehearse(cell, cell.arms[1], 0.02)
    np.testing.assert_array_equal(cell.model.body_pos, before[0])
    for arm, home in zip(cell.arms, before[1], strict=True):
        np.testing.assert_array_equal(arm.home_rad, home)


def test_the_base_of_an_arm_is_placed_and_the_cell_can_be_run(tmp_path):
    asked = cells.load(tmp_path, far_apart())
    with pytest.raises(InputError, match="out of reach"):
        admit(asked, tmp_path / "before")
    moves = place(asked, search="base")
    assert [move.arm for move in moves] == ["nurse"]
    (move,) = moves
    assert move.after.fits
    assert not move.before.fits
    assert move.home_rad is None
    assert move == place(asked, search="base")[0], "a search is seeded"
    values = {"nurse": {"base_position_m": move.position_m, "base_wxyz": move.wxyz}}
    source = tmp_path / "duet.toml"
    admit(rewrite(asked, source, tmp_path / "placed.toml", values), tmp_path / "after")


def test_a_home_can_be_placed_where_the_base_is_bolted_down(tmp_path):
    content = cells.duet()
    content["arm"][1] |= {
        "job": [{"kind": "wait", "duration_s": 1.0}],
        "home_rad": [0.0, 0.0, 0.0],
        "base_position_m": [-0.4, 0.0, 0.0],
    }
    with pytest.raises(InputError, match="start in collision"):
        admit(cells.load(tmp_path, content), tmp_path / "before")
    (move,) = place(cells.load(tmp_path, content), search="home")
    assert move.position_m is None
    assert move.home_rad is not None
    assert move.after.fits


TEXT = """# A comment at the top.
name = "duet"
[simulation]
plant = "kinematic"

[[arm]]  # the first
name = "surgeon"
model = "planar3"
base_position_m = [0.55, 0.0, 0.0]
home_rad = [2.2, 0.9, -0.6]
operator = { kind = "hold" }

[[arm]]
name = "nurse"
model = "planar3"
home_rad = [
  1.9, -0.9,
  -0.6,
]  # bent
priority = 1
[[arm.job]]
kind = "wait"
duration_s = 1.0
"""


def test_only_the_values_of_a_file_change(tmp_path):
    source, target = tmp_path / "duet.toml", tmp_path / "other.toml"
    source.write_text(TEXT)
    asked = scenario.load(source)
    values = {"nurse": {"home_rad": (1.0, 2.0, 3.0), "base_position_m": (-1.0, 0.5, 0.0)}}
    placed = rewrite(asked, source, target, values)
    assert placed.arm[1].home_rad == (1.0, 2.0, 3.0)
    assert placed.arm[1].base_position_m == (-1.0, 0.5, 0.0)
    old, new = TEXT.splitlines(), target.read_text().splitlines()
    assert [line for line in new if line not in old] == [
        "base_position_m = [-1, 0.5, 0]",
        "home_rad = [1, 2, 3]  # bent",
    ]
    assert [line for line in old if line not in new] == ["home_rad = [", "  1.9, -0.9,", "  -0.6,", "]  # bent"]  # fmt: skip


def test_where_a_text_cannot_be_changed_the_whole_scenario_is_written(tmp_path):
    content = cells.duet()
    source = tmp_path / "inline.toml"
    arms = ", ".join(
        f'{{ name = "{arm["name"]}", model = "planar3", home_rad = {arm["home_rad"]}, operator = {{ kind = "hold" }} }}'
        for arm in content["arm"]
    )
    source.write_text(f"arm = [{arms}]\n")
    asked = scenario.load(source)
    placed = rewrite(
        asked, source, tmp_path / "other.toml", {"nurse": {"base_position_m": (1.0, 0.0, 0.0)}}
    )
    assert placed.arm[1].base_position_m == (1.0, 0.0, 0.0)
    assert placed.arm[0] == asked.arm[0]


def test_the_command_writes_a_scenario_beside_the_first(tmp_path, capsys):
    path = cells.write(tmp_path, far_apart())
    assert main(["place", str(path)]) == 0
    said = capsys.readouterr().out
    assert "arm.nurse: base_position_m = [" in said
    assert "can be run: workcell run" in said
    assert main(["check", str(tmp_path / "duet_placed.toml")]) == 0
    assert scenario.load(path).arm[1].base_position_m == (-1.4, 0.3, 0.0), "the first stays"


def test_what_cannot_be_placed_is_said(tmp_path, capsys):
    content = far_apart()
    content["arm"][1]["base_position_m"] = [-9.0, 0.0, 0.0]
    path = cells.write(tmp_path, content)
    assert main(["place", str(path), "--evaluations", "20", "--search", "base"]) == 1
    assert "no place found: the tool stays" in capsys.readouterr().out
    assert main(["place", str(path), "--out", str(path)]) == 2
    assert "is the scenario itself" in capsys.readouterr().err
