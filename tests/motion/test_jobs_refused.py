"""Jobs that cannot be done as written are refused when the file is read, by arm, job and what is allowed."""

from __future__ import annotations

from typing import Any

import pytest

from tests import cells
from workcell.errors import InputError

FETCH = {"kind": "fetch", "instrument": "clamp"}
GIVE = {"kind": "exchange", "arm": "surgeon", "instrument": "clamp", "direction": "give"}
TAKE = {"kind": "exchange", "arm": "surgeon", "instrument": "probe", "direction": "take"}
PUT = {"kind": "put", "instrument": "clamp"}
SCALPEL = {"name": "scalpel", "held_by": "nurse"}


def cell(*jobs: dict[str, Any], instruments: tuple[dict[str, Any], ...] = ()) -> dict[str, Any]:
    """A clamp lies on the ground and the surgeon holds a probe."""
    content = cells.duet()
    content["arm"][1]["job"] = list(jobs)
    content["instrument"] = [
        {"name": "clamp", "position_m": [0.0, -0.5, 0.3]},
        {"name": "probe", "held_by": "surgeon"},
        *instruments,
    ]
    return content


@pytest.mark.parametrize(
    ("jobs", "names"),
    [
        ([FETCH | {"instrument": "saw"}], ("job 0 (fetch)", "'saw'", "clamp, probe")),
        ([FETCH, PUT | {"instrument": "saw"}], ("job 1 (put)", "'saw'", "clamp, probe")),
        ([{"kind": "present", "arm": "anna"}], ("job 0 (present)", "'anna'", "surgeon")),
        ([{"kind": "meet", "arm": "nurse"}], ("job 0 (meet)", "'nurse'", "surgeon")),
        (
            [{"kind": "present", "arm": "surgeon", "entry": "below"}],
            ("entry = 'below'", "'left', 'right' or 'above'"),
        ),
        ([TAKE | {"direction": "swap"}], ("direction = 'swap'", "'give' or 'take'")),
        ([GIVE], ("job 0 (exchange)", "clamp must be held by nurse", "nobody holds it")),
        ([FETCH, GIVE], ("job 1 (exchange)", "surgeon holds an instrument already")),
        ([FETCH, TAKE], ("job 1 (exchange)", "nurse holds an instrument already")),
        ([TAKE, FETCH], ("job 1 (fetch)", "nurse holds an instrument already")),
        (
            [FETCH | {"instrument": "probe"}],
            ("job 0 (fetch)", "probe must be held by nobody", "surgeon holds it"),
        ),
        ([PUT], ("job 0 (put)", "clamp must be held by nurse", "nobody holds it")),
        ([TAKE, PUT | {"instrument": "probe"}], ("job 1 (put)", "probe has no place of its own")),
        ([{"kind": "polish"}], ("'polish'", "'fetch'", "'exchange'")),
    ],
)
def test_a_job_that_cannot_be_done_is_refused(tmp_path, jobs, names):
    with pytest.raises(InputError) as refused:
        cells.load(tmp_path, cell(*jobs))
    for name in ("nurse", *names):
        assert name in str(refused.value), str(refused.value)


def test_what_fits_is_not_refused(tmp_path):
    assert cells.load(tmp_path, cell(FETCH, PUT, TAKE)).arm[1].job[2].kind == "exchange"


def test_jobs_must_also_fit_when_they_are_repeated(tmp_path):
    """The surgeon's probe can be taken once; the second time round nobody is there to give it."""
    content = cell(TAKE)
    content["arm"][1]["job_repeat"] = 2
    with pytest.raises(InputError, match="probe must be held by surgeon then, but nurse holds it"):
        cells.load(tmp_path, content)


@pytest.mark.parametrize(
    ("instrument", "names"),
    [
        ({"name": "saw"}, ("saw", "position_m", "held_by")),
        (SCALPEL | {"position_m": [0, 0, 1]}, ("scalpel", "position_m", "held_by")),
        (SCALPEL | {"held_by": "anna"}, ("held_by", "'anna'", "surgeon, nurse")),
        (SCALPEL | {"held_by": "surgeon"}, ("scalpel", "surgeon holds another one already")),
        (SCALPEL | {"rests_on": ["shelf"]}, ("rests_on", "'shelf'", "there is none")),
        (SCALPEL | {"name": "probe"}, ("probe", "more than once")),
        (SCALPEL | {"name": "nurse"}, ("nurse", "name of an arm")),
    ],
)
def test_an_instrument_that_is_nowhere_or_twice_is_refused(tmp_path, instrument, names):
    with pytest.raises(InputError) as refused:
        cells.load(tmp_path, cell(FETCH, instruments=(instrument,)))
    for name in names:
        assert name in str(refused.value), str(refused.value)
