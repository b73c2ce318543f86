import dataclasses
import itertools
import json

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from workcell.errors import TraceError
from workcell.signals import Layout
from workcell.trace.metrics import decay_time_s, reversals, summarise
from workcell.trace.readings import (
    Span,
    joint_columns,
    longest_scaling,
    period_s,
    scaled_down,
    smallest_distance_m,
    spans,
    support_arm,
)
from workcell.trace.table import load
from workcell.trace.writer import TraceWriter


@pytest.fixture(scope="module")
def summary(run):
    return summarise(run.trace)


def test_the_synthetic_run_is_summed_up(run, summary):
    assert summary["ticks"] == 1500
    assert summary["duration_s"] == pytest.approx(6.0)
    assert summary["final_mode"] == "halt"
    assert summary["mode_changes"] == 4
    assert summary["mode_changes_per_s"] == pytest.approx(4 / 6)
    counts = [summary[f"nurse.mode_{mode}_ticks"] for mode in ("run", "scale", "halt")]
    assert sum(counts) == 1500
    assert summary["scaling_ticks"] == counts[1]
    assert summary["nurse.reason_ttc_ticks"] == counts[1]
    assert summary["smallest_ttc_s"] == pytest.approx(0.8)
    assert summary["smallest_ttc_command_reason"] == "ttc"
    assert summary["ttc_held_within_2_percent"] == 1.0
    assert summary["nurse.path_done_s"] == pytest.approx(1200 * 0.004)
    assert summary["nurse.speed_reversals"] == 2, "it slows, speeds up and slows again"
    assert summary["nurse.smallest_scale"] == 0.0
    assert summary["nurse.max_tool_error_m"] == 1e-4
    assert summary["contact"] is False
    assert summary["completed"] is None, "no arm was given jobs that could be done"
    assert summary["smallest_ttc_command_own_s"] == summary["smallest_ttc_command_s"]
    assert summary["smallest_check_distance_m"] == pytest.approx(
        summary["smallest_distance_m"] + 0.01
    )


def test_the_distance_decays_with_t_min(summary):
    """The law of velocity scaling against a standing arm: e-folding in t_min."""
    assert summary["nurse.distance_decay_s"] == pytest.approx(0.8, rel=0.01)
    assert summary["nurse.speed_decay_s"] == pytest.approx(0.8, rel=0.1)


def test_an_arm_that_stands_has_nothing_to_report(summary):
    assert summary["surgeon.elbow_travel_m"] is None
    assert summary["surgeon.distance_decay_s"] is None
    assert summary["surgeon.peak_joint_acceleration_rad_s2"] == 0.0
    assert summary["surgeon.scaled_ticks"] == 0


def test_extremes_are_those_of_the_columns(run, summary):
    trace = run.trace
    tick = round(summary["smallest_distance_time_s"] / period_s(trace))
    pair = int(np.argmin(trace["pair_distance_m"][tick]))
    assert trace["pair_distance_m"].min() == summary["smallest_distance_m"]
    assert trace["pair_distance_m"][tick, pair] == summary["smallest_distance_m"]
    assert " and ".join(trace.layout.pairs[pair]) == summary["smallest_distance_pair"]
    commanded = trace["command_rad_s"][:, 3:]
    peak = np.abs(np.diff(commanded, axis=0)).max() / period_s(trace)
    assert summary["nurse.peak_joint_acceleration_rad_s2"] == pytest.approx(peak)


def test_pairs_that_are_meant_to_meet_are_left_out(run):
    trace = run.trace
    meeting = trace.layout.pairs.index(("surgeon/link2_capsule", "nurse/link3_capsule"))
    others = np.delete(trace["pair_distance_m"], meeting, axis=1)
    apart = smallest_distance_m(trace, apart_only=True)
    np.testing.assert_array_equal(apart, others.min(axis=1))
    assert (apart > smallest_distance_m(trace)).any()


def test_blocks_leave_no_mark_in_the_metrics(run, summary, monkeypatch):
    """Retreats and an arm's own hand included, against columns that are held as a whole."""
    settings = run.trace.metadata["settings"]
    settings["arm"][1]["job"] = [{"kind": "retreat", "speed_m_s": 0.1}]
    entries = {
        b"settings": json.dumps(settings).encode(),
        b"hands": json.dumps({"probe=nurse": [2, 5]}).encode(),
    }
    table = run.trace.table
    holders = np.where(np.arange(len(run.trace)) % 700 < 300, "probe=nurse", "probe=surgeon")
    job = np.where(run.trace["time_s"] > 2.5, "retreat", "meet")
    for name, values in (("holders", holders), ("nurse.job", job)):
        place = table.column_names.index(name)
        table = table.set_column(place, table.schema.field(place), pa.array(values.tolist()))
    table = table.replace_schema_metadata(table.schema.metadata | entries)
    trace = dataclasses.replace(run.trace, rows=table)
    distance, rate = trace["pair_distance_m"].copy(), trace["pair_rate_m_s"]
    leaving = ((rate > 1e-4) | (distance > 0.8 * 0.1)).all(axis=1) & (job == "retreat")
    distance[np.ix_(holders == "probe=nurse", [2, 5])] = np.inf
    whole = summarise(trace)
    monkeypatch.setattr("workcell.trace.stored._ROW_GROUP_ROWS", 64)
    np.testing.assert_array_equal(smallest_distance_m(trace), distance.min(axis=1))
    assert (smallest_distance_m(trace) > trace["pair_distance_m"].min(axis=1)).any()
    assert leaving.any()
    found = summarise(trace)
    assert found["nurse.retreat_smallest_scale"] == trace["nurse.scale"][leaving].min()
    assert found == whole
    assert whole["nurse.distance_decay_s"] == summary["nurse.distance_decay_s"]


def test_a_summary_is_json(summary):
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary


def test_a_run_without_settings_pairs_or_contact(run, tmp_path):
    """Nothing to measure against is None, never a number made up."""
    layout = Layout(arms=(), joints=("a",), nq=1, nv=1, pairs=())
    row = {
        "tick": 0, "time_s": 0.0, "plant_qpos": None, "plant_qvel": None,
        "qpos": np.zeros(1), "qvel": np.zeros(1),
        "pair_distance_m": np.zeros(0), "pair_rate_m_s": np.zeros(0), "closest_pair": None,
        "ttc_s": None, "ttc_pair": None, "witness_i_m": None, "witness_j_m": None,
        "wanted_rad_s": np.zeros(1), "ttc_command_s": None, "check_distance_m": None,
        "check_state": "off", "command_rad_s": np.zeros(1), "mode": "run",
        "t_min_s": 1.0, "criterion": "none", "entry": "", "ttc_command_pair": None, "holders": "",
        "closing_cause": "",
    }  # fmt: skip
    with TraceWriter(tmp_path, layout, {}, 0.002) as writer:
        writer.append(row)
    summary = summarise(load(tmp_path))
    for name in ("smallest_distance_m", "smallest_distance_apart_m", "smallest_ttc_s",
                 "smallest_check_distance_m", "ttc_held_within_2_percent"):  # fmt: skip
        assert summary[name] is None
    with pytest.raises(TraceError, match="has no arms"):
        support_arm(load(tmp_path))
    with TraceWriter(tmp_path, layout, {}, 0.002):
        pass
    with pytest.raises(TraceError, match="no rows"):
        summarise(load(tmp_path))


def test_arms_by_priority_and_joints_by_prefix(run):
    assert support_arm(run.trace) == "nurse"
    assert joint_columns(run.trace, "nurse") == [3, 4, 5]


@given(st.lists(st.booleans(), max_size=30))
def test_spans_cover_the_mask(mask):
    found = spans(np.array(mask, dtype=bool))
    covered = np.zeros(len(mask), dtype=bool)
    for span in found:
        assert len(span) > 0
        covered[span.start : span.stop] = True
    assert covered.tolist() == mask
    assert all(a.stop < b.start for a, b in itertools.pairwise(found))


def test_the_longest_scaling_is_of_one_pair(run):
    span = longest_scaling(run.trace, "nurse")
    pairs = run.trace["nurse.limiting_pair"][span.start : span.stop]
    assert len(set(pairs)) == 1
    assert pairs[0] >= 0
    assert longest_scaling(run.trace, "surgeon") is None
    assert isinstance(span, Span)


def with_column(trace, name, values):
    """The trace with other values in a column."""
    place = trace.table.column_names.index(name)
    field = trace.table.schema.field(place)
    table = trace.table.set_column(place, field, pa.array(values, field.type))
    return dataclasses.replace(trace, rows=table)


def test_only_what_the_time_to_collision_bounds_counts_as_scaling(run):
    trace = run.trace
    halted = trace["nurse.mode"] == "halt"
    assert halted.any()
    assert (trace["nurse.scale"][halted] == 0).all()
    assert not scaled_down(trace, "nurse")[halted].any()
    span = longest_scaling(trace, "nurse")
    reason = trace["nurse.reason"].copy()
    reason[span.start + 10 :] = "rise"
    rising = with_column(trace, "nurse.reason", reason)
    assert longest_scaling(rising, "nurse") != span
    # While the factor only rises back, t_min need not be held and is not asked for.
    longer = with_column(rising, "ttc_s", np.where(reason == "rise", 3.0, 0.8))
    assert summarise(longer)["ttc_held_within_2_percent"] == 1.0
    shorter = with_column(trace, "ttc_s", np.where(np.arange(len(trace)) % 2, 0.8, 0.9))
    assert summarise(shorter)["ttc_held_within_5_percent"] == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize(
    ("speed", "count"),
    [
        ([0, 1, 2, 3], 0),
        ([0, 1, 0.5, 2], 2),
        ([1, 1.001, 1, 1.001, 1], 0),
        ([0, 0, 0], 0),
        (np.sin(np.linspace(0, 4 * np.pi, 200)), 4),
        ([3, 1, 2, 1, 2, 1], 4),
    ],
)
def test_reversals(speed, count):
    assert reversals(np.array(speed, dtype=float)) == count


@given(st.floats(0.05, 20), st.floats(1e-3, 10))
def test_decay_of_an_exponential(constant_s, start):
    time_s = np.linspace(3.0, 5.0, 50)
    assert decay_time_s(time_s, start * np.exp(-time_s / constant_s)) == pytest.approx(constant_s)


def test_what_does_not_decay_has_no_time_constant():
    time_s = np.linspace(0, 1, 10)
    assert decay_time_s(time_s, 1 + time_s) is None
    assert decay_time_s(time_s, np.zeros(10)) is None


def test_a_step_is_not_sought_across_missing_rows(run):
    """Salvaged rows may have a gap, and the speeds on its two sides are no step of a joint."""
    whole = run.trace.table
    trace = dataclasses.replace(
        run.trace, rows=pa.concat_tables([whole.slice(0, 100), whole.slice(700, 100)])
    )
    assert period_s(trace) == pytest.approx(period_s(run.trace), rel=1e-12)
    command = trace["command_rad_s"]
    assert np.abs(np.diff(command, axis=0)).max() / period_s(trace) > 100
    assert summarise(trace)["nurse.peak_joint_acceleration_rad_s2"] < 1.0
