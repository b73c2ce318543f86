"""Damage of every kind, and what must come out of it unharmed."""

import shutil

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from workcell.errors import TraceError
from workcell.trace.journal import JournalReader, JournalWriter
from workcell.trace.salvage import salvage
from workcell.trace.stored import INDEX_NAME, INTEGRITY_KEY, convert
from workcell.trace.table import JOURNAL_NAME, TRACE_NAME, load
from workcell.view import recording as view

RECORDING = "recording.rrd"
BATCH = 100


@pytest.fixture
def damaged(run, tmp_path, monkeypatch):
    """A folder with the run's trace as journal and as table of several row groups."""
    monkeypatch.setattr("workcell.trace.stored._ROW_GROUP_ROWS", 4 * BATCH)
    folder = tmp_path / "damaged"
    folder.mkdir()
    journal = folder / JOURNAL_NAME
    schema = run.trace.table.schema
    entries = {k: v for k, v in schema.metadata.items() if k != INTEGRITY_KEY}
    writer = JournalWriter(journal, schema.with_metadata(entries))
    for batch in (
        run.trace.table.replace_schema_metadata(entries).combine_chunks().to_batches(BATCH)
    ):
        writer.write(batch)
    writer.close()
    convert(journal, folder / TRACE_NAME)
    return folder


def flip(path, offset):
    content = bytearray(path.read_bytes())
    content[offset] ^= 0x10
    path.write_bytes(content)


def save(folder):
    return salvage(folder, folder.with_name("saved"), recording_name=RECORDING)


def test_an_undamaged_run_comes_through_whole(damaged, run):
    saved = save(damaged)
    assert saved.losses == ()
    assert load(saved.trace).digest() == run.trace.digest()


def test_rows_around_a_damaged_row_group_survive(damaged, run):
    path = damaged / TRACE_NAME
    with pq.ParquetFile(path) as file:
        column = file.metadata.row_group(1).column(2)
    flip(path, column.data_page_offset + column.total_compressed_size // 2)
    with pytest.raises(TraceError):
        load(damaged)
    saved = save(damaged)
    assert "rows 400 to 799 are damaged" in saved.losses[0]
    whole = run.trace.table
    kept = pa.concat_tables([whole.slice(0, 400), whole.slice(800)])
    assert load(saved.trace).table.equals(kept)


def test_batches_around_a_flipped_bit_survive(damaged, run):
    (damaged / TRACE_NAME).unlink()
    path = damaged / JOURNAL_NAME
    flip(path, path.stat().st_size // 2)
    with pytest.raises(TraceError):
        load(damaged)
    saved = save(damaged)
    assert "hold no intact batch" in saved.losses[0]
    assert saved.rows == len(run.trace) - BATCH
    assert load(saved.trace)["tick"][-1] == len(run.trace) - 1


def test_the_journal_of_a_killed_run_ends_with_its_last_whole_batch(damaged, run):
    (damaged / TRACE_NAME).unlink()
    path = damaged / JOURNAL_NAME
    path.write_bytes(path.read_bytes()[:-200])
    saved = save(damaged)
    assert "unfinished or damaged batch" in saved.losses[0]
    assert saved.rows == len(run.trace) - BATCH


def test_a_table_without_its_index_falls_back_to_the_journal(damaged, run):
    path = damaged / TRACE_NAME
    path.write_bytes(path.read_bytes()[:-9])
    (damaged / INDEX_NAME).unlink()
    saved = save(damaged)
    assert "its index at the end cannot be read" in saved.losses[0]
    assert saved.rows == len(run.trace)
    (damaged / JOURNAL_NAME).unlink()
    assert save(damaged).trace is None


def test_a_recording_cut_off_keeps_its_beginning(damaged, run, tmp_path):
    whole = view.record(run.trace, run.scene, tmp_path / RECORDING)
    cut = damaged / RECORDING
    cut.write_bytes(whole.read_bytes()[: int(0.9 * whole.stat().st_size)])
    saved = save(damaged)
    assert saved.recording is not None
    assert "is damaged" in saved.losses[0]
    assert saved.recording.stat().st_size > 0.5 * whole.stat().st_size
    cut.write_bytes(b"no recording")
    assert save(damaged).recording is None


def test_misuse_is_named(damaged, tmp_path):
    with pytest.raises(TraceError, match="another folder"):
        salvage(damaged, damaged, recording_name=RECORDING)
    (tmp_path / "empty").mkdir()
    with pytest.raises(TraceError, match="neither a trace nor a recording"):
        salvage(tmp_path / "empty", tmp_path / "x", recording_name=RECORDING)


def test_a_trace_from_before_a_signal_is_read(damaged, run):
    """An older trace lacks a column: the rest of it is as good as ever."""
    older = JournalReader(damaged / JOURNAL_NAME)
    rows = pa.Table.from_batches(older, older.schema).drop_columns(["mode"])
    shutil.rmtree(damaged)
    damaged.mkdir()
    writer = JournalWriter(damaged / JOURNAL_NAME, rows.schema)
    for batch in rows.combine_chunks().to_batches():
        writer.write(batch)
    writer.close()
    trace = load(damaged)
    assert (trace["ttc_s"][:5] == run.trace["ttc_s"][:5]).all()
    with pytest.raises(TraceError, match="from before column 'mode' was logged"):
        trace["mode"]


def test_a_short_run_loses_a_chunk_to_a_flipped_bit_wherever_it_is(run, tmp_path):
    """Seeded bits all over the file: rows, page headers, index and end."""
    folder = tmp_path / "short"
    folder.mkdir()
    for name in (TRACE_NAME, INDEX_NAME):
        shutil.copy(run.trace.source.with_name(name), folder / name)
    path = folder / TRACE_NAME
    whole = path.read_bytes()
    with pq.ParquetFile(path) as file:
        assert file.num_row_groups > 1
    offsets = [
        *np.random.default_rng(5).integers(0, len(whole), 10),
        len(whole) - 7,
        len(whole) - 60,
    ]
    for offset in offsets:
        path.write_bytes(whole)
        flip(path, int(offset))
        saved = save(folder)
        assert saved.rows >= len(run.trace) - 512, f"byte {offset} of {len(whole)}"
        assert len(saved.losses) == 1


def test_a_table_cut_short_keeps_the_groups_before_the_cut(run, tmp_path):
    folder = tmp_path / "cut"
    folder.mkdir()
    for name in (TRACE_NAME, INDEX_NAME):
        shutil.copy(run.trace.source.with_name(name), folder / name)
    path = folder / TRACE_NAME
    content = path.read_bytes()
    path.write_bytes(content[: int(0.7 * len(content))])
    saved = save(folder)
    assert "the copy in trace.index is used" in saved.losses[0]
    assert saved.rows in (512, 1024)
    path.write_bytes(content)
    flip(folder / INDEX_NAME, 40)
    assert save(folder).losses == (), "a damaged copy is not believed"
