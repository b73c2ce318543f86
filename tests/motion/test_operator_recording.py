"""Recorded operators: the file, what is refused, gaps and jumps."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from workcell import scenario
from workcell.errors import InputError
from workcell.motion.operators.recording import RecordingOperator, believed_samples, faults
from workcell.motion.operators.recording_file import (
    FORMAT,
    FORMAT_COLUMN,
    POSE_COLUMNS,
    Samples,
    read,
    write,
)
from workcell.motion.operators.samples import JumpRule, Sample, SampleFilter, Tolerances
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


def test_a_recording_says_its_format(tmp_path):
    path = write(tmp_path / "hand.csv", circle())
    header, first, *_ = path.read_text().splitlines()
    assert header.split(",") == [*POSE_COLUMNS, FORMAT_COLUMN]
    assert first.split(",")[-1] == str(FORMAT)


@pytest.mark.parametrize(
    ("said", "words"),
    [
        (None, None),
        ("1", None),
        (
            "2",
            "format = 2: is newer than this program, which reads formats up to 1: update workcell",
        ),
        ("0", "format = 0: is no format; allowed are 1 to 1"),
        ("9" * 50, "format = 9999.*: is no format"),
        ("one", "format = one: is no format"),
    ],
)
@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_older_formats_are_read_and_newer_ones_refused(tmp_path, kind, said, words):
    path, columns = tmp_path / f"hand.{kind}", table(circle())
    if said is not None:
        columns = {FORMAT_COLUMN: [said] * len(circle().time_s), **columns}
    if said == "2":  # A newer format may have other columns.
        del columns["qw"]
    if kind == "csv":
        write_csv(path, columns)
    else:
        pq.write_table(pa.table(columns), path)
    if words is None:
        assert np.array_equal(read(path).time_s, circle().time_s)
    else:
        with pytest.raises(InputError, match=words):
            read(path)


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
        "empty.csv": "columns time_s, x_m, .*: are missing.*the file has no columns",
        "header.csv": "has no samples",
        "ragged.csv": "row 1: has 3 entries, the header has 8",
        "hand.parquet": "not a readable parquet",
        "hand.txt": "allowed is a .csv or .parquet",
    }.items():
        with pytest.raises(InputError, match=message):
            read(tmp_path / name)


def judge(path, duration_s=2.0, home=HOME, **settings):
    full = scenario.Recording.model_validate({"kind": "recording", "file": str(path), **settings})
    return faults(full, home, UPRIGHT, duration_s=duration_s, period_s=PERIOD_S)


def with_times(times) -> Samples:
    samples = circle()
    n = len(times)
    return Samples(np.array(times), samples.position_m[:n], samples.wxyz[:n], None)


FOREIGN_CLOCKS = {
    "unix seconds": (1.79e9 + np.arange(5) / 50, "row 1, column time_s = 1790000000.0: lies after"),
    "unix nanoseconds": (1.79e18 + 2e7 * np.arange(5), "row 1, column time_s = 1.79e+18: lies"),
    "nanoseconds": (2e7 * np.arange(5), "row 2, column time_s = 20000000.0: only the first sample"),
    "microseconds": (2e4 * np.arange(5), "row 2, column time_s = 20000.0: only the first sample"),
    "milliseconds": (1.0 * np.arange(5), "its samples are 1 s apart or more, each a gap"),
    "one sample": (np.zeros(1), "has one sample"),
}


@pytest.mark.parametrize("clock", FOREIGN_CLOCKS)
def test_a_recording_on_another_clock_than_the_runs_is_refused_before_the_run(tmp_path, clock):
    times, message = FOREIGN_CLOCKS[clock]
    path = write(tmp_path / "hand.csv", with_times(times))
    (fault,) = judge(path)
    assert str(path) in fault
    assert message in fault


def test_an_integer_column_of_nanoseconds_is_judged_like_a_float_one(tmp_path):
    columns = table(with_times(np.arange(5)))
    columns["time_s"] = [1_790_000_000_000_000_000 + 20_000_000 * k for k in range(5)]
    pq.write_table(pa.table(columns), tmp_path / "hand.parquet")
    (fault,) = judge(tmp_path / "hand.parquet")
    assert "row 1, column time_s = 1.79e+18: lies after the end; the run ends at 2 s" in fault


def test_start_s_counts_when_a_recording_is_held_against_the_run(tmp_path):
    path = write(tmp_path / "hand.csv", circle())
    assert judge(path) == []
    (fault,) = judge(path, start_s=2.5)
    assert "with start_s = 2.5: lies after the end" in fault


def test_a_start_farther_off_than_a_stream_may_leap_is_refused(tmp_path):
    path = write(tmp_path / "hand.csv", circle())
    away = HOME + np.array([0.0, 0.3, 0.0])
    (fault,) = judge(path, home=away)
    assert "row 1 is 0.3 m from the tool's start; allowed is jump_m = 0.05 m" in fault
    assert judge(path, home=away, jump_m=0.31) == []
    samples = circle()
    swapped = Samples(samples.time_s, samples.position_m, np.roll(samples.wxyz, -1, axis=1), None)
    (fault,) = judge(write(tmp_path / "xyzw.csv", swapped))
    assert "row 1 is turned by 3.14 rad from the tool's start" in fault


def test_what_the_file_cannot_be_read_for_is_said_before_the_run_too(tmp_path):
    columns = table(circle())
    columns["time_s"][60:] = columns["time_s"][:40]
    (fault,) = judge(write_csv(tmp_path / "hand.csv", columns))
    assert "row 61, column time_s = 0.0: is not later than 1.18" in fault


def test_parquet_columns_that_are_no_numbers_are_named(tmp_path):
    columns = table(circle(duration_s=0.1))
    columns["x_m"] = [[x, x] for x in columns["x_m"]]
    pq.write_table(pa.table(columns), tmp_path / "lists.parquet")
    with pytest.raises(InputError, match="column x_m: is of type list<"):
        read(tmp_path / "lists.parquet")
    episode = {"timestamp": [0.0, 0.1], "state": [[0.0, 1.0], [0.0, 1.0]]}
    pq.write_table(pa.table(episode), tmp_path / "episode.parquet")
    with pytest.raises(InputError) as error:
        read(tmp_path / "episode.parquet")
    assert "columns time_s, x_m, y_m, z_m, qw, qx, qy, qz: are missing" in str(error.value)
    assert "the file has timestamp, state" in str(error.value)


HUGE = {
    "position": ("x_m", "1e30", "row 4, column x_m = 1e+30: allowed is a magnitude of 1000"),
    "quaternion": ("qw", "1e300", "row 4, column qw = 1e+300: allowed is a magnitude of 10"),
    "infinity": ("z_m", "-inf", "row 4, column z_m = -inf: is not finite"),
    "digits": ("y_m", "1_0", "row 4, column y_m = '1_0': is not a number"),
}


@pytest.mark.parametrize("case", HUGE)
def test_numbers_that_no_column_can_mean_are_refused(tmp_path, case):
    column, value, message = HUGE[case]
    columns = table(circle())
    columns[column][3] = value
    with pytest.raises(InputError) as error:
        read(write_csv(tmp_path / "hand.csv", columns))
    assert message in str(error.value)
    assert len(str(error.value)) < 2000


def test_messages_stay_short_however_many_rows_are_at_fault(tmp_path):
    columns = table(circle())
    columns["qw"] = [3.0] * len(columns["qw"])
    with pytest.raises(InputError, match="and 95 more") as error:
        read(write_csv(tmp_path / "hand.csv", columns))
    assert len(str(error.value)) < 2000


def spoiled(first, last, away_m=0.3) -> Samples:
    """The circle, with the samples of some rows somewhere else."""
    samples = circle()
    moved = samples.position_m.copy()
    moved[first:last] += [0.0, away_m, 0.0]
    return Samples(samples.time_s, moved, samples.wxyz, None)


def test_a_spike_of_one_sample_is_not_followed(tmp_path):
    path = write(tmp_path / "hand.csv", spoiled(40, 41))
    times, setpoints = play(path, 1.9)
    states = np.array([w.state for w in setpoints])
    assert set(states[(times > 0.79) & (times < 0.81)]) == {"jump"}
    truth = circle(1 / PERIOD_S)
    path = np.array([w.target.position_m for w in setpoints])
    assert np.linalg.norm(path - truth.position_m[: len(path)], axis=1).max() < 5e-3
    assert states[-1] == "valid"


@pytest.mark.parametrize("confirm_s", [0.0, 0.1, 0.4])
def test_a_jump_is_believed_once_the_recording_has_stayed_there(tmp_path, confirm_s):
    path = write(tmp_path / "hand.csv", spoiled(50, 100))
    times, setpoints = play(path, 1.9, jump_confirm_s=confirm_s)
    states = [w.state for w in setpoints]
    assert times[states.index("catching_up")] == pytest.approx(1.0 + confirm_s, abs=PERIOD_S)
    assert setpoints[-1].target.position_m[1] > HOME[1] + 0.2 - 0.4 * confirm_s


def test_a_jump_at_the_very_end_is_never_believed(tmp_path):
    path = write(tmp_path / "hand.csv", spoiled(98, 100))
    times, setpoints = play(path, 2.5)
    states = np.array([w.state for w in setpoints])
    assert set(states[(times > 1.945) & (times < 1.98)]) == {"jump"}
    assert states[-1] == "ended"
    assert setpoints[-1].target.position_m == pytest.approx(circle().position_m[97], abs=1e-3)


def test_live_streams_and_recordings_believe_the_same_samples(tmp_path):
    """The same samples, some thrown far off, through both: what the one drops the other drops."""
    random = np.random.default_rng(4)
    samples = circle()
    moved = samples.position_m.copy()
    for first in random.integers(5, 95, size=6):
        moved[first : first + random.integers(1, 9)] += random.uniform(-0.4, 0.4, size=3)
    samples = Samples(samples.time_s, moved, samples.wxyz, None)
    options = {"jump_confirm_s": 0.1, "jump_m": 0.05, "jump_rad": 0.35}
    recording = scenario.Recording.model_validate({"kind": "recording", "file": "x", **options})
    live = scenario.Live.model_validate({"kind": "live", **options})
    stream = SampleFilter(Tolerances(1e9, 1e9, 0.0, 1e-3), JumpRule(live))
    verdicts = [
        stream.judge(t, Sample(t, p, q))
        for t, p, q in zip(samples.time_s.tolist(), samples.position_m, samples.wxyz, strict=True)
    ]
    good = np.flatnonzero(np.array(verdicts) == "valid")
    assert 0 < len(good) < len(verdicts)
    assert np.array_equal(believed_samples(samples, recording), good)
