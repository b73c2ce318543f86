"""What two runs differ in, told from their metrics."""

import dataclasses

import pyarrow as pa
import pytest

from workcell.regression.words import compare_in_words, waits
from workcell.trace.readings import period_s


def edited(trace, **columns):
    """The trace with some columns replaced."""
    table = trace.table
    for name, values in columns.items():
        name = name.replace("__", ".")
        place = table.column_names.index(name)
        table = table.set_column(
            place, table.schema.field(place), pa.array(values, table.schema.field(place).type)
        )
    return dataclasses.replace(trace, rows=table)


def test_a_run_against_itself_has_nothing_to_tell(duet):
    words = compare_in_words(duet.trace, duet.trace)
    assert words.same
    assert words.settings == ()
    assert words.headline() == "no difference that a person would notice"


def test_waits_are_counted_by_their_number_and_length(duet):
    scale = [1.0] * len(duet.trace)
    scale[50:70] = [0.0] * 20  # 0.4 s
    scale[100:103] = [0.0] * 3  # 0.06 s, too short to be seen
    scale[150:200] = [0.5] * 50  # slowed, not waiting
    mode = ["run"] * len(duet.trace)
    mine = edited(duet.trace, nurse__scale=scale, nurse__mode=mode)
    count, waited_s = waits(mine, "nurse")
    assert count == 1
    assert waited_s == pytest.approx(20 * period_s(duet.trace))
    plain = edited(duet.trace, nurse__scale=[1.0] * len(duet.trace), nurse__mode=mode)
    told = {f.name: f.difference for f in compare_in_words(mine, plain).figures}
    assert told["nurse: waits"] == "1 more"
    assert told["nurse: time waited"] == "0.4 s more"
    told = {f.name: f.difference for f in compare_in_words(plain, mine).figures}
    assert told["nurse: waits"] == "1 fewer"


def test_distances_are_told_in_millimetres(duet):
    nearer = [[x - 0.01 for x in row] for row in duet.trace["pair_distance_m"].tolist()]
    told = {
        f.name: f.difference
        for f in compare_in_words(edited(duet.trace, pair_distance_m=nearer), duet.trace).figures
    }
    assert told["smallest distance"] == "10 mm nearer"
