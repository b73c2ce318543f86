"""Operators in a run: recorded and played back, exchanged on the command line, refused without a person."""

from __future__ import annotations

import numpy as np
import pytest

from tests import cells
from workcell import run as runner
from workcell import scenario
from workcell.errors import InputError
from workcell.live.operator_file import write_replay, write_takes
from workcell.trace.table import load


def busy() -> dict:
    """A person beside the nurse of the duet; within the reach of planar arms."""
    content = cells.duet()
    content["simulation"]["duration_s"] = 2.0
    content["check"] = {"enabled": False}
    content["arm"][0]["operator"] = {
        "kind": "human",
        "sites": [{"position_m": [-0.1, 0.40, 0.3]}, {"position_m": [-0.1, 0.45, 0.3]}],
        "pause_s": [0.05, 0.1],
        "start_s": 0.1,
        "withdraw_m": [0.0, -0.05, 0.0],
        "elbow_probability": 0.0,
    }
    content["change"] = [
        {"time_s": 0.5, "t_min_s": 1.2},
        {"time_s": 1.0, "criterion": "armd"},
    ]
    return content


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("busy")
    out = folder / "run"
    runner.run(cells.load(folder, busy()), out)
    write_replay(out)
    return out


def test_changes_act_at_their_tick(recorded):
    trace = load(recorded)
    at = np.searchsorted(trace["time_s"], [0.5, 1.0])
    assert trace["t_min_s"][[at[0] - 1, at[0]]].tolist() == [1.0, 1.2]
    assert trace["criterion"][[at[1] - 1, at[1]]].tolist() == ["artc", "armd"]


def test_a_recorded_person_replays_to_the_same_bits(recorded, tmp_path):
    runner.run(scenario.load(recorded / "replay.toml"), tmp_path)
    first, second = load(recorded), load(tmp_path)
    assert len(np.unique(first["surgeon.job"])) > 1
    for name in first.table.column_names:
        if not name.endswith((".job", ".operator_state")):
            equal_nan = first[name].dtype.kind == "f"
            assert np.array_equal(first[name], second[name], equal_nan=equal_nan), name


def test_any_operator_becomes_a_recording_by_its_file(recorded, tmp_path, monkeypatch):
    file = recorded / "operator_surgeon.csv"
    for name in ("handover", str(cells.write(tmp_path, busy()))):
        loaded = scenario.load(name, (f"arm.surgeon.operator.file={file}",))
        operator = loaded.arm[0].operator
        assert isinstance(operator, scenario.Recording)
        assert operator.file == str(file)
    monkeypatch.chdir(recorded)
    here = scenario.load("handover", ("arm.surgeon.operator.file=operator_surgeon.csv",))
    assert here.arm[0].operator == scenario.Recording(kind="recording", file=str(file))


def test_an_operator_exchanged_by_kind_leaves_its_keys_behind(tmp_path):
    path = cells.write(tmp_path, busy())
    assert scenario.load(path, ("arm.surgeon.operator.kind=live",)).arm[0].operator == (
        scenario.Live(kind="live")
    )


def test_a_live_operator_is_refused_where_nobody_sits(tmp_path):
    loaded = cells.load(tmp_path, busy(), "arm.surgeon.operator.kind=live")
    with pytest.raises(InputError, match=r"arm\.surgeon\.operator\.kind = 'live'.*teleop"):
        runner.run(loaded, tmp_path / "run")


def test_a_recording_at_fault_is_refused_before_the_first_tick(tmp_path):
    (tmp_path / "hand.csv").write_text("time_s,x_m\n0,1\n")
    loaded = cells.load(tmp_path, busy(), "arm.surgeon.operator.file=hand.csv")
    with pytest.raises(InputError, match=r"columns y_m, z_m, .*: are missing"):
        runner.run(loaded, tmp_path / "run")


def test_a_run_without_operators_has_nothing_to_record(tmp_path, recorded):
    content = busy()
    content["arm"][0] |= {"job": [{"kind": "wait", "duration_s": 1.0}], "priority": 2}
    del content["arm"][0]["operator"]
    content["arm"][1]["job"] = [{"kind": "wait", "duration_s": 1.0}]
    content["simulation"]["duration_s"] = 0.02
    runner.run(cells.load(tmp_path, content), tmp_path / "run")
    with pytest.raises(InputError, match="no arm of this run has an operator"):
        write_replay(tmp_path / "run")


def test_a_take_is_a_recording_that_begins_at_zero_and_can_be_played(recorded, tmp_path):
    first, second = write_takes(recorded, [(25, 100), (100, 160), (400, 400)])
    assert [first.name, second.name] == ["take_1_surgeon.csv", "take_2_surgeon.csv"]
    trace = load(recorded)
    take = np.genfromtxt(first, delimiter=",", names=True)
    assert take["time_s"][0] == 0.0
    assert len(take) == 75
    wanted = trace["surgeon.target_position_m"][25:100]
    assert np.array_equal(np.stack([take[f"{axis}_m"] for axis in "xyz"], axis=1), wanted)
    assert write_takes(recorded, []) == []
    loaded = scenario.load("handover", (f"arm.surgeon.operator.file={first}",))
    assert isinstance(loaded.arm[0].operator, scenario.Recording)
