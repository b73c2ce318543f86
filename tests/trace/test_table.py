import dataclasses
import os
import signal
import subprocess
import sys
import warnings
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from workcell.errors import TraceError
from workcell.signals import ARM_SIGNALS, CELL_SIGNALS, Layout, columns
from workcell.trace.table import JOURNAL_NAME, TRACE_NAME, load
from workcell.trace.writer import TraceWriter

LAYOUT = Layout(
    arms=("surgeon", "nurse"), joints=("s1", "n1"), nq=2, nv=2, pairs=(("s/a", "n/a"), ("s/b", "t"))
)
SMALL = Layout(arms=(), joints=("s1",), nq=1, nv=1, pairs=())
PERIOD_S = 0.002
METADATA = {"versions": '{"mujoco": "3.17.0"}', "scenario": "12e4"}


def make_row(tick, layout=LAYOUT):
    """A row whose every value depends on the tick and on the column."""
    rng = np.random.default_rng(tick)
    row = {}
    for column in columns(layout):
        kind = column.signal.dtype
        if column.signal.nullable and rng.random() < 0.3:
            row[column.name] = None
        elif column.width is not None:
            row[column.name] = rng.normal(size=column.width)
        elif kind == "string":
            row[column.name] = str(rng.choice(["run", "scale", "", "überlang"]))
        else:
            row[column.name] = tick if kind != "float64" else rng.normal()
    return row


def write(folder, count, layout=LAYOUT, close=True, **options):
    writer = TraceWriter(folder, layout, METADATA, PERIOD_S, **options)
    for tick in range(count):
        writer.append(make_row(tick, layout))
    if close:
        writer.close()
    return writer


def as_record(row, layout):
    """The same row as an object with attributes, the way a controller hands it over."""
    return SimpleNamespace(
        **{s.name: row[s.name] for s in CELL_SIGNALS},
        arms={
            arm: SimpleNamespace(**{s.name: row[f"{arm}.{s.name}"] for s in ARM_SIGNALS})
            for arm in layout.arms
        },
    )


def test_what_is_written_is_read_back(tmp_path):
    write(tmp_path, 700)
    assert not (tmp_path / JOURNAL_NAME).exists()
    trace = load(tmp_path)
    assert len(trace) == 700
    assert trace.layout == LAYOUT
    assert trace.metadata["versions"] == {"mujoco": "3.17.0"}
    assert trace.metadata["scenario"] == "12e4", "a hash that looks like a number stays text"
    rows = [make_row(tick) for tick in range(700)]
    for column in columns(LAYOUT):
        values = trace[column.name]
        shape = (700,) if column.width is None else (700, column.width)
        assert values.shape == shape, column.name
        null = -1 if column.signal.dtype.startswith("int") else np.nan
        wanted = [
            np.full(shape[1:], null) if row[column.name] is None else row[column.name]
            for row in rows
        ]
        np.testing.assert_array_equal(values, np.array(wanted, dtype=values.dtype))


def test_a_row_may_be_an_object(tmp_path):
    write(tmp_path / "mapping", 20)
    with TraceWriter(tmp_path / "object", LAYOUT, METADATA, PERIOD_S) as writer:
        for tick in range(20):
            writer.append(as_record(make_row(tick), LAYOUT))
    written = [(tmp_path / kind / TRACE_NAME).read_bytes() for kind in ("mapping", "object")]
    assert written[0] == written[1]


def test_vectors_are_copied(tmp_path):
    row = make_row(0)
    with TraceWriter(tmp_path, LAYOUT, {}, PERIOD_S) as writer:
        for value in (1.0, 2.0):
            row["qpos"][:] = value
            writer.append(row)
    assert load(tmp_path)["qpos"].tolist() == [[1.0, 1.0], [2.0, 2.0]]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"qpos": np.zeros(3)}, r"column qpos has shape \(3,\), the layout asks for \(2,\)"),
        ({"qpos": None}, "column qpos may not be null"),
        ({"qpos": 1.0}, r"column qpos has shape \(\)"),
        ({"qpos": np.zeros(2, complex)}, "column qpos holds complex128"),
        ({"tick": 0.5}, "column tick takes int64"),
        ({"mode": 3}, "column mode takes string"),
        ({"nurse.scale": None}, "column nurse.scale may not be null"),
        ({"nurse.sclae": 1.0}, "unknown columns nurse.sclae"),
    ],
)
def test_a_bad_row_is_refused_by_name(tmp_path, change, message):
    with TraceWriter(tmp_path, LAYOUT, {}, PERIOD_S, flush_s=PERIOD_S) as writer:
        if set(change) <= set(make_row(0)):
            writer.append(make_row(0))
        with pytest.raises(TraceError, match=message):
            writer.append(make_row(1) | change)
        kept = len(load(writer.journal))
    assert len(load(tmp_path)) == kept, "the rows before it stay"


def test_a_missing_column_is_named(tmp_path):
    row = make_row(0)
    with TraceWriter(tmp_path, LAYOUT, {}, PERIOD_S) as writer:
        record = as_record(row, LAYOUT)
        del record.arms["nurse"].scale
        with pytest.raises(TraceError, match="scale"):
            writer.append(record)
        del row["qvel"]
        with pytest.raises(TraceError, match="qvel"):
            TraceWriter(tmp_path / "mapping", LAYOUT, {}, PERIOD_S).append(row)


@settings(max_examples=25, deadline=None)
@given(count=st.integers(0, 40), batch=st.integers(1, 50))
def test_batches_leave_no_mark(tmp_path_factory, count, batch):
    folder = tmp_path_factory.mktemp("batches")
    write(folder / "one", count, flush_s=1.0)
    write(folder / "many", count, flush_s=batch * PERIOD_S)
    assert load(folder / "one").digest() == load(folder / "many").digest()
    one, many = (folder / name / TRACE_NAME for name in ("one", "many"))
    assert one.read_bytes() == many.read_bytes()


def test_the_digest_sees_a_last_bit_and_a_null(tmp_path):
    digests = set()
    for k, value in enumerate([0.25, np.nextafter(0.25, 1), None, float("nan")]):
        with TraceWriter(tmp_path / str(k), SMALL, {}, PERIOD_S) as writer:
            writer.append(make_row(0, SMALL) | {"ttc_s": value})
        digests.add(load(tmp_path / str(k)).digest())
    assert len(digests) == 4


@pytest.mark.parametrize("layout", [SMALL, dataclasses.replace(LAYOUT, pairs=())])
@pytest.mark.parametrize("count", [0, 3])
def test_empty_things_are_traces_too(tmp_path, layout, count):
    write(tmp_path, count, layout)
    trace = load(tmp_path)
    assert trace["pair_distance_m"].shape == (count, 0)
    assert trace["qpos"].shape == (count, layout.nq)


def test_a_long_run_crosses_row_groups(tmp_path, monkeypatch):
    monkeypatch.setattr("workcell.trace.stored._ROW_GROUP_ROWS", 16)
    write(tmp_path, 50, flush_s=10 * PERIOD_S)
    assert pq.ParquetFile(tmp_path / TRACE_NAME).metadata.num_row_groups == 4
    assert load(tmp_path)["tick"].tolist() == list(range(50))


@pytest.mark.parametrize("closed", [True, False])
def test_a_column_in_blocks_is_the_column(tmp_path, monkeypatch, closed):
    """Nulls, strings and vectors alike, from the file and from a journal."""
    monkeypatch.setattr("workcell.trace.stored._ROW_GROUP_ROWS", 16)
    writer = write(tmp_path, 50, close=closed, flush_s=7 * PERIOD_S)
    writer.flush()
    trace = load(tmp_path)
    assert trace.digest() == dataclasses.replace(trace, rows=trace.table).digest()
    ticks = np.array([3, 4, 40, 49])
    for column in columns(LAYOUT):
        whole = np.array([row[column.name] is None for row in map(make_row, range(50))])
        values = trace[column.name]
        blocks = list(trace.blocks(column.name))
        assert [start for start, _ in blocks] == [0, 16, 32, 48]
        np.testing.assert_array_equal(np.concatenate([block for _, block in blocks]), values)
        some = [start for start, _ in trace.blocks(column.name, ticks)]
        assert some == [0, 32, 48], "a block without any of the ticks is passed over"
        if column.width:
            np.testing.assert_array_equal(np.isnan(values).all(axis=1), whole)
            last = [column.width - 1]
            np.testing.assert_array_equal(trace.part(column.name, ticks), values[ticks])
            part = trace.part(column.name, ticks, last)
            np.testing.assert_array_equal(part, values[ticks][:, last])
            assert trace.part(column.name, entries=last).strides == values[:, last].strides
    with pytest.raises(TraceError, match="no column 'ttc'"):
        next(trace.blocks("ttc"))


def test_what_is_read_is_what_was_verified(tmp_path):
    """A folder that is recorded anew, or a file damaged under way, never mixes into a trace at hand."""
    write(tmp_path, 50)
    trace = load(tmp_path)
    write(tmp_path, 3)
    assert trace["tick"].tolist() == list(range(50))
    again = load(tmp_path)
    content = again.source.read_bytes()
    place = [column.name for column in columns(LAYOUT)].index("qpos")
    chunk = pq.ParquetFile(again.source).metadata.row_group(0).column(place)
    middle = chunk.data_page_offset + chunk.total_compressed_size // 2
    again.source.write_bytes(flip(content, middle, 3))
    with pytest.raises(TraceError, match="damaged"):
        again["qpos"]


def test_a_killed_run_leaves_its_rows(tmp_path):
    code = (
        "import sys; sys.path.insert(0, sys.argv[2])\n"
        "from test_table import *\n"
        "write(sys.argv[1], 330, close=False, flush_s=0.1)\n"
        "print('written', flush=True)\n"
        "import time; time.sleep(60)\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path), os.path.dirname(__file__)],
        stdout=subprocess.PIPE,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == b"written\n"
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    process.stdout.close()
    assert not (tmp_path / TRACE_NAME).exists()
    trace = load(tmp_path)
    assert len(trace) == 300, "all but the last 0.1 s"
    np.testing.assert_array_equal(trace["qpos"], [make_row(k)["qpos"] for k in range(300)])


def test_flushing_by_the_clock(tmp_path):
    write(tmp_path, 3, close=False, flush_s=1.0, flush_wall_s=0.0)
    assert len(load(tmp_path)) == 3


def test_an_older_trace_in_the_folder_is_removed(tmp_path):
    write(tmp_path, 5)
    write(tmp_path, 3, close=False, flush_s=PERIOD_S)
    assert len(load(tmp_path)) == 3


@pytest.fixture(scope="module")
def journal(tmp_path_factory):
    """Bytes of a journal of three batches of four rows, and where its batches start."""
    folder = tmp_path_factory.mktemp("journal")
    starts = []
    with TraceWriter(folder, SMALL, METADATA, PERIOD_S, flush_s=4 * PERIOD_S) as writer:
        for tick in range(12):
            if tick % 4 == 0:
                starts.append(writer.journal.stat().st_size)
            writer.append(make_row(tick, SMALL))
        content = writer.journal.read_bytes()
    return content, starts, load(folder)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(fraction=st.floats(0, 1))
def test_a_cut_journal_keeps_its_whole_batches(tmp_path_factory, journal, fraction):
    content, starts, _ = journal
    cut = starts[0] + int(fraction * (len(content) - starts[0]))
    path = tmp_path_factory.mktemp("cut") / JOURNAL_NAME
    path.write_bytes(content[:cut])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        trace = load(path)
    whole = sum(end <= cut for end in [*starts[1:], len(content)])
    torn = cut - [*starts, len(content)][whole]
    assert trace["tick"].tolist() == list(range(4 * whole))
    assert trace.torn_bytes == torn
    assert [f"{torn} bytes was dropped" in str(w.message) for w in caught] == [True] * bool(torn)


def flip(content, position, bit):
    damaged = bytearray(content)
    damaged[position] ^= 1 << bit
    return bytes(damaged)


def load_unless_refused(path):
    """The trace, or None if it was refused by name; any other failure is one of the test."""
    try:
        return load(path)
    except TraceError as error:
        if str(path) not in str(error):
            raise
        return None


@settings(max_examples=300, deadline=None)
@given(fraction=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
@pytest.mark.filterwarnings("ignore:.*unfinished last batch")
def test_a_flipped_bit_in_the_journal_is_never_believed(tmp_path_factory, journal, fraction, bit):
    content, starts, whole = journal
    position = int(fraction * len(content))
    path = tmp_path_factory.mktemp("flip") / JOURNAL_NAME
    path.write_bytes(flip(content, position, bit))
    trace = load_unless_refused(path)
    if trace is None:
        return
    # Padding carries nothing. A damaged length in the last batch looks like a torn one.
    assert trace.metadata == whole.metadata
    if trace.torn_bytes:
        assert position >= starts[2]
        assert trace["tick"].tolist() == list(range(8))
    else:
        assert trace.digest() == whole.digest()


@settings(max_examples=300, deadline=None)
@given(fraction=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
def test_a_flipped_bit_in_the_table_is_never_believed(tmp_path_factory, journal, fraction, bit):
    whole = journal[2]
    content = whole.source.read_bytes()
    path = tmp_path_factory.mktemp("flip") / TRACE_NAME
    path.write_bytes(flip(content, int(fraction * len(content)), bit))
    trace = load_unless_refused(path)
    if trace is None:
        return
    assert (trace.digest(), trace.metadata) == (whole.digest(), whole.metadata)


def test_pages_carry_checksums(tmp_path):
    """Damage in a column's pages is found by any reader, not only by ours."""
    write(tmp_path, 500)
    path = tmp_path / TRACE_NAME
    chunk = pq.ParquetFile(path).metadata.row_group(0).column(2)
    middle = chunk.data_page_offset + chunk.total_compressed_size // 2
    path.write_bytes(flip(path.read_bytes(), middle, 3))
    with pytest.raises(OSError, match="CRC"):
        pq.ParquetFile(path, page_checksum_verification=True).read()
    with pytest.raises(TraceError, match="damaged"):
        load(path)


@pytest.mark.parametrize("kept", [0, 3, 0.5, 0.999])
def test_a_truncated_table_is_refused(tmp_path, kept):
    write(tmp_path, 5)
    path = tmp_path / TRACE_NAME
    content = path.read_bytes()
    path.write_bytes(content[: kept if isinstance(kept, int) else int(kept * len(content))])
    with pytest.raises(TraceError, match=r"trace\.parquet: is damaged"):
        load(tmp_path)


def test_a_newer_schema_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("workcell.trace.writer.SCHEMA_VERSION", 2)
    write(tmp_path, 1)
    monkeypatch.undo()
    with pytest.raises(TraceError, match="schema version 2 is newer than 1"):
        load(tmp_path)


def test_what_is_no_trace_is_refused(tmp_path):
    with pytest.raises(TraceError, match=r"neither trace\.parquet nor"):
        load(tmp_path)
    with pytest.raises(TraceError, match="no such file"):
        load(tmp_path / "gone.parquet")
    foreign = tmp_path / TRACE_NAME
    pq.write_table(pa.table({"a": [1]}), foreign)
    with pytest.raises(TraceError, match="not a trace"):
        load(foreign)
    (tmp_path / JOURNAL_NAME).write_bytes(b"something else")
    with pytest.raises(TraceError, match="not a journal"):
        load(tmp_path / JOURNAL_NAME)


def test_misuse_is_named(tmp_path):
    with pytest.raises(TraceError, match="pairs are set by the layout"):
        TraceWriter(tmp_path, LAYOUT, {"pairs": "[]"}, PERIOD_S)
    writer = write(tmp_path, 1)
    assert writer.close() == tmp_path / TRACE_NAME, "closing twice does no harm"
    with pytest.raises(TraceError, match="closed"):
        writer.append(make_row(1))
    with pytest.raises(TraceError, match="no column 'ttc'; there are tick"):
        load(tmp_path)["ttc"]
