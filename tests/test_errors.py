"""Messages stay short, on one line a fault, and printable, whatever the input was."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from workcell import errors
from workcell.errors import InputError


@given(st.lists(st.text(max_size=3000), min_size=1, max_size=40), st.text(max_size=3000))
def test_a_message_is_short_and_printable(faults, file):
    message = str(InputError(faults, file=file))
    assert len(message) <= 2000
    assert all(line.isprintable() for line in message.split("\n"))


def test_faults_left_out_are_counted():
    message = str(
        InputError([f"key_{k} = {'9' * 100}: is wrong" for k in range(50)], file="f.toml")
    )
    told = message.splitlines()
    assert told[0].startswith("f.toml: key_0 = 999")
    assert told[-1] == f"... and {50 - (len(told) - 1)} more faults"


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.5, "0.5"),
        ("a\x00b", "'a\\x00b'"),
        pytest.param(10**5000, "an integer of more than 80 digits", id="long"),
        (-(10**90), "an integer of more than 80 digits"),
        pytest.param([10**5000], "a list that is too long to be shown", id="list"),
    ],
)
def test_values_are_quoted_on_one_line(value, text):
    assert errors.shown(value) == text


def test_a_long_value_loses_its_middle():
    told = errors.shown("a" * 500 + "z")
    assert len(told) <= errors.VALUE_LENGTH
    assert told.startswith("'aaa")
    assert told.endswith("az'")


def test_an_unknown_name_is_answered_with_the_nearest():
    assert errors.did_you_mean("handoff", ["handover", "impasse"]) == "; did you mean 'handover'?"
    assert errors.did_you_mean("qqq", ["handover"]) == ""


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (FileNotFoundError(2, "No such file", "x"), "No such file: 'x'"),
        (RecursionError(), "is nested too deeply"),
        (MemoryError(), "needs more memory than there is"),
        (ValueError("Error: bad\n  size"), "bad size"),
        (ValueError(), "ValueError"),
    ],
)
def test_what_a_library_says_becomes_a_reason(error, text):
    assert errors.reason(error) == text


def test_errors_of_a_library_are_refusals_and_ours_stay_what_they_are():
    with (
        pytest.raises(InputError, match=r"a\.xml: arm.x.model: cannot be read: bad; allowed is"),
        errors.refused("arm.x.model: cannot be read", ValueError, file="a.xml", but="allowed is"),
    ):
        raise ValueError("bad")
    with pytest.raises(KeyError), errors.refused("what", ValueError):
        raise KeyError("ours")
    inner = InputError("inner")
    with pytest.raises(InputError) as caught, errors.refused("what", Exception):
        raise inner
    assert caught.value is inner
