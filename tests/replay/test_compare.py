import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from workcell.regression.compare import RESTING_PER_S, compare
from workcell.regression.excerpt import excerpt
from workcell.regression.rows import read_rows, reference_ticks, write_rows
from workcell.signals import columns


@pytest.fixture(scope="session")
def whole(duet):
    return excerpt(duet.trace)


def changed(whole, **values):
    """The run with some columns replaced."""
    return dataclasses.replace(whole, values={**whole.values, **values})


def with_settings(whole, **settings):
    identity = dataclasses.replace(whole.identity, settings={**whole.identity.settings, **settings})
    return dataclasses.replace(whole, identity=identity)


def test_a_run_is_the_same_as_itself_and_as_its_text(duet, whole, tmp_path):
    assert compare(whole, whole).kind == "same"
    write_rows(tmp_path / "rows.csv", duet.trace)
    text = read_rows(tmp_path / "rows.csv", whole.identity, whole.length)
    result = compare(whole, text)
    assert result.kind == "same", result.headline()
    assert result.compared == len(reference_ticks(duet.trace))
    assert result.notes == ()


@settings(deadline=None, max_examples=40)  # the machine may be shared
@given(data=st.data())
def test_a_change_beyond_its_tolerance_is_found_and_one_within_is_not(duet, whole, data):
    numbers = [
        c
        for c in columns(duet.trace.layout)
        if c.signal.dtype == "float64" and c.signal.shape != "wxyz" and not c.signal.nullable
    ]
    column = data.draw(st.sampled_from(numbers), label="column")
    tick = data.draw(st.integers(0, len(duet.trace) - 1), label="tick")
    values = whole.values[column.name].copy()
    place = (tick,) if values.ndim == 1 else (tick, data.draw(st.integers(0, values.shape[1] - 1)))
    allowed = column.signal.atol + column.signal.rtol * abs(values[place])
    values[place] += 0.9 * allowed
    assert compare(changed(whole, **{column.name: values}), whole).kind == "same"
    values[place] += 0.2 * allowed
    result = compare(changed(whole, **{column.name: values}), whole)
    assert [(d.column, d.first_tick, d.ticks) for d in result.differences] == [
        (column.name, tick, 1)
    ]
    assert result.first.largest == pytest.approx(1.1 * allowed, rel=1e-3)


def test_the_first_to_move_is_named_by_tick_then_by_stage(whole):
    scale, command = whole.values["nurse.scale"].copy(), whole.values["command_rad_s"].copy()
    path = whole.values["nurse.path_s"].copy()
    scale[100:] += 0.1
    command[100:, 0] += 0.1
    path[101:] += 0.1  # an earlier stage, but a tick later
    result = compare(
        changed(whole, **{"nurse.scale": scale, "command_rad_s": command, "nurse.path_s": path}),
        whole,
    )
    assert [d.stage for d in result.differences] == ["scaling", "command", "target"]
    assert "from tick 100 (2.000 s) on, first in nurse.scale (stage scaling)" in result.headline()


def test_what_rounding_decides_is_no_difference(whole):
    """The sign of a quaternion, the pair of two in one place, and what belongs to arms at rest."""
    flipped = -whole.values["nurse.tool_wxyz"]
    assert compare(changed(whole, **{"nurse.tool_wxyz": flipped}), whole).kind == "same"

    pair = whole.values["closest_pair"].copy()
    other = (pair[50] + 1) % len(whole.identity.layout.pairs)
    tied = whole.tied["closest_pair"].copy()
    tied[50, other] = True
    twins = dataclasses.replace(whole, tied={**whole.tied, "closest_pair": tied})
    pair[50] = other
    assert compare(changed(whole, closest_pair=pair), twins).kind == "same"
    assert compare(changed(whole, closest_pair=pair), whole).kind == "differs"

    still = {name: whole.values[name].copy() for name in ("ttc_s", "ttc_pair", "witness_i_m")}
    still["ttc_s"][:], still["ttc_pair"][:] = np.nan, -1
    creeping = {name: values.copy() for name, values in still.items()}
    creeping["ttc_s"][9], creeping["ttc_pair"][9] = 2.0 / RESTING_PER_S, 1
    creeping["witness_i_m"][9] += 1.0
    assert compare(changed(whole, **creeping), changed(whole, **still)).kind == "same"
    creeping["ttc_s"][9] = 10.0
    assert compare(changed(whole, **creeping), changed(whole, **still)).first.column == "ttc_s"


def test_a_step_may_come_late_within_the_slack_only(whole):
    mode = whole.values["nurse.mode"]
    change = int(np.flatnonzero(mode[1:] != mode[:-1])[0]) + 1
    late = mode.copy()
    late[change : change + 2] = mode[change - 1]
    run = changed(whole, **{"nurse.mode": late})
    assert compare(run, whole, slack_ticks=2).kind == "same"
    assert compare(run, whole, slack_ticks=1).first.first_tick == change + 0
    assert compare(run, whole).kind == "differs"


def test_null_and_a_number_differ(whole):
    command = whole.values["ttc_command_s"].copy()
    tick = int(np.flatnonzero(command < 2.0)[0])
    command[tick] = np.nan
    found = compare(changed(whole, ttc_command_s=command), whole).first
    assert (found.column, found.first_tick, found.run) == ("ttc_command_s", tick, "null")


def test_what_cannot_be_compared_says_why(whole):
    control = {**whole.identity.settings["control"], "t_min_s": 0.7}
    faster = with_settings(whole, control=control)
    result = compare(faster, whole)
    assert result.kind == "not comparable"
    assert "control.t_min_s 0.7 | 1.0" in result.headline()
    assert compare(faster, whole, other_settings=True).kind == "same"
    renamed = with_settings(whole, name="other", description="words", expect={})
    assert compare(renamed, whole).kind == "same", "words do not move arms"

    newer = dataclasses.replace(
        whole, identity=dataclasses.replace(whole.identity, schema_version=99)
    )
    assert "schema version 99 of the run" in compare(newer, whole).headline()
    layout = dataclasses.replace(whole.identity.layout, joints=("a", "b"))
    limbs = dataclasses.replace(whole, identity=dataclasses.replace(whole.identity, layout=layout))
    assert (
        "other joints: only the run has a, b; only the reference"
        in compare(limbs, whole).headline()
    )


def test_a_shorter_run_differs_by_its_length(whole):
    half = whole.length // 2
    short = dataclasses.replace(
        whole,
        ticks=whole.ticks[:half],
        length=half,
        values={name: values[:half] for name, values in whole.values.items()},
        tied={name: values[:half] for name, values in whole.tied.items()},
    )
    result = compare(short, whole)
    assert (result.kind, result.first, result.compared) == ("differs", None, half)
    assert f"{half} ticks instead of {whole.length}" in result.headline()
