"""`workcell compile` leaves nothing for a tick to compile."""

import subprocess
import sys

import pytest


@pytest.mark.long
def test_after_it_no_law_waits_to_be_compiled():
    """In a process of its own: the laws of this one have been called by other tests."""
    check = (
        "from workcell.control import laws, warm\n"
        "warm.warm()\n"
        "from workcell.control.laws import gate\n"
        "print([name for law, name in laws._laws.items() if not law.signatures\n"
        "       and law.py_func.__module__ != gate.__name__])"
    )
    done = subprocess.run([sys.executable, "-c", check], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
