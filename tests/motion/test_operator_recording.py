"""Recorded operators: the file, what is refused, gaps and jumps."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from workcell import scenario
from workcell.errors import InputError
from workcell.motion.operators.recording import (
    POSE_COLUMNS,
    RecordingOperator,
    Samples,
    read,
    write,
)
from workcell.motion.orientation import rotation_between

HOME = np.array([0.4, 0.5, 0.4])
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
PERIOD_S = 0.002


def circle(rate_hz=50.0, duration_s=2.0, twist=False) -> Samples:
    time_s = np.arange(0.0, duration_s, 1 / rate_hz)
    angle = 0.5 * (1 - np.cos(time_s))  # starts at rest
    rate = 0.5 * np.sin(time_s)
    zero = np.zeros_like(time_s)
    position = HOME + 0.1 * np.column_stack([np.cos(angle) - 1, np.sin(angle), zero])
    wxyz = np.column_stack([np.cos(angle / 2), zero, zero, np.sin(angle / 2)])
    velocity = 0.1 * rate[:, None] * np.column_stack([-np.sin(angle), np.cos(angle), zero])
    both = np.hstack([velocity, np.column_stack([zero, zero, rate])])
    return Samples(time_s, position, wxyz, both if twist else None)


def play(path, duration_s=2.5, **settings):
    full = scenario.Recording.model_validate({"kind": "recording", "file": str(path), **settings})
    operator = RecordingOperator(full, HOME, UPRIGHT, period_s=PERIOD_S)
    times = np.arange(round(duration_s / PERIOD_S)) * PERIOD_S
    return times, [operator.setpoint(float(t)) for t in times]


def table(samples: Samples) -> dict[str, list]:
    columns = np.column_stack([samples.time_s, samples.position_m, samples.wxyz])
    return {name: columns[:, k].tolist() for k, name in enumerate(POSE_COLUMNS)}


def write_csv(path, columns: dict[str, list]):
    rows = zip(*columns.values(), strict=True)
    lines = [",".join(columns), *(",".join(str(x) for x in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize("twist", [False, True])
def test_a_recording_reads_back_to_the_same_bits(tmp_path, twist):
    samples = circle(twist=twist)
    again = read(write(tmp_path / "hand.csv", samples))
    for a, b in (
        (samples.time_s, again.time_s),
        (samples.position_m, again.position_m),
        (samples.wxyz, again.wxyz),
    ):
        assert np.array_equal(a, b)
    assert (again.twist is None) if not twist else np.array_equal(samples.twist, again.twist)


def test_parquet_is_as_good_as_csv(tmp_path):
    columns = table(circle())
    pq.write_table(pa.table(columns), tmp_path / "hand.parquet")
    from_csv = read(write_csv(tmp_path / "hand.csv", columns))
    from_parquet = read(tmp_path / "hand.parquet")
    assert np.array_equal(from_csv.position_m, from_parquet.position_m)
    assert np.array_equal(from_csv.wxyz, from_parquet.wxyz)


@pytest.mark.parametrize("rate_hz", [20.0, 50.0, 333.0, 1000.0])
def test_any_rate_is_followed(tmp_path, rate_hz):
    samples = circle(rate_hz)
    _, setpoints = play(write(tmp_path / "hand.csv", samples), 1.9)
    truth = circle(1 / PERIOD_S)
    error = [
        np.linalg.norm(w.target.position_m - p)
        for w, p in zip(setpoints, truth.position_m, strict=False)
    ]
    turn = [
        np.linalg.norm(rotation_between(w.target.wxyz, q))
        for w, q in zip(setpoints, truth.wxyz, strict=False)
    ]
    assert max(error) < 5e-4
    assert max(turn) < 5e-3
    assert {w.state for w in setpoints} == {"valid"}


def test_a_recording_of_ticks_passes_to_the_last_bit(tmp_path):
    samples = circle(1 / PERIOD_S, twist=True)
    _, setpoints = play(write(tmp_path / "hand.csv", samples), 1.9)
    for k, setpoint in enumerate(setpoints):
        assert np.array_equal(setpoint.target.position_m, samples.position_m[k])
        assert np.array_equal(setpoint.target.velocity_m_s, samples.twist[k, :3])


def test_the_arm_stands_over_a_gap_and_comes_back_without_a_leap(tmp_path):
    samples = circle()
    keep = (samples.time_s < 0.8) | (samples.time_s > 1.4)
    cut = Samples(samples.time_s[keep], samples.position_m[keep], samples.wxyz[keep], None)
    times, setpoints = play(write(tmp_path / "hand.csv", cut), 2.6, max_speed_m_s=0.2)
    states = np.array([w.state for w in setpoints])
    inside = (times > 0.9) & (times < 1.35)
    assert set(states[inside]) == {"gap"}
    before = cut.position_m[np.searchsorted(cut.time_s, 0.8) - 1]
    path = np.array([w.target.position_m for w in setpoints])
    assert np.abs(path[(times > 1.3) & (times < 1.35)] - before).max() < 2e-3
    assert "catching_up" in states
    assert states[-1] == "ended"
    assert_no_leap(setpoints, 0.2, 2.0)
    assert path[-1] == pytest.approx(cut.position_m[-1], abs=1e-3)


def test_a_jump_is_crossed_at_limited_speed(tmp_path):
    samples = circle()
    moved = samples.position_m + np.where(samples.time_s > 1.0, 0.15, 0.0)[:, None]
    path = write(tmp_path / "hand.csv", Samples(samples.time_s, moved, samples.wxyz, None))
    _, setpoints = play(path, 2.8, max_speed_m_s=0.25, max_acceleration_m_s2=1.5)
    assert {"jump", "catching_up"} <= {w.state for w in setpoints}
    assert_no_leap(setpoints, 0.25, 1.5)
    assert setpoints[-1].target.position_m == pytest.approx(moved[-1], abs=1e-3)


def test_before_it_starts_the_arm_waits(tmp_path):
    times, setpoints = play(write(tmp_path / "hand.csv", circle()), 1.0, start_s=0.5)
    assert {w.state for w, t in zip(setpoints, times, strict=True) if t < 0.49} == {"waiting"}
    assert np.array_equal(setpoints[100].target.position_m, HOME)


def assert_no_leap(setpoints, speed, acceleration):
    path = np.array([w.target.position_m for w in setpoints])
    velocity = np.diff(path, axis=0) / PERIOD_S
    assert np.linalg.norm(velocity, axis=1).max() <= speed * 1.001
    # A target that passes unchanged may differ by one more tick's worth of acceleration.
    change = np.linalg.norm(np.diff(velocity, axis=0), axis=1).max() / PERIOD_S
    assert change <= 3.001 * acceleration


FAULTS = {
    "missing": (lambda c: c.pop("qz"), "column qz: is missing"),
    "nan": (lambda c: c["y_m"].__setitem__(4, "nan"), "row 5, column y_m = nan: is not finite"),
    "text": (lambda c: c["x_m"].__setitem__(2, "left"), "row 3, column x_m = 'left'"),
    "time": (
        lambda c: c["time_s"].__setitem__(6, 0.01),
        "row 7, column time_s = 0.01: is not later than 0.1",
    ),
    "unit": (lambda c: c["qw"].__setitem__(3, 1.01), "row 4, columns qw qx qy qz: have norm 1.01"),
    "negative": (lambda c: c["time_s"].__setitem__(0, -1.0), "row 1, column time_s = -1"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_what_cannot_be_followed_is_refused_with_row_and_column(tmp_path, fault):
    spoil, message = FAULTS[fault]
    columns = table(circle())
    spoil(columns)
    path = write_csv(tmp_path / "hand.csv", columns)
    with pytest.raises(InputError) as error:
        read(path)
    assert str(path) in str(error.value)
    assert message in str(error.value)


def test_a_quaternion_within_the_tolerance_is_normalised(tmp_path):
    columns = table(circle())
    columns["qw"] = [1.0005 * x for x in columns["qw"]]
    columns["qz"] = [1.0005 * x for x in columns["qz"]]
    samples = read(write_csv(tmp_path / "hand.csv", columns))
    assert np.linalg.norm(samples.wxyz, axis=1) == pytest.approx(1.0, abs=1e-15)


def test_files_that_are_no_recordings(tmp_path):
    (tmp_path / "empty.csv").write_text("")
    (tmp_path / "header.csv").write_text(",".join(POSE_COLUMNS) + "\n")
    (tmp_path / "ragged.csv").write_text(",".join(POSE_COLUMNS) + "\n0,1,2\n")
    (tmp_path / "hand.parquet").write_text("not parquet")
    (tmp_path / "hand.txt").write_text("")
    for name, message in {
        "none.csv": "no such recording",
        "empty.csv": "column time_s: is missing",
        "header.csv": "has no samples",
        "ragged.csv": "row 1: has 3 entries, the header has 8",
        "hand.parquet": "not a readable parquet",
        "hand.txt": "allowed is a .csv or .parquet",
    }.items():
        with pytest.raises(InputError, match=message):
            read(tmp_path / name)
