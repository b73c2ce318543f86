"""What a tick leaves behind: the rows of the trace, with a field for every signal of `workcell.signals`.

A signal is declared there and nowhere else. A record that is built without one of them, or with
another, fails at once and names it. The fields are given by keyword in `outcome.py`.
"""

from __future__ import annotations

from collections import namedtuple

from workcell.signals import ARM_SIGNALS, CELL_SIGNALS

ArmRecord = namedtuple("ArmRecord", [signal.name for signal in ARM_SIGNALS])
"""One arm's part of a row."""

TickRecord = namedtuple("TickRecord", [*(signal.name for signal in CELL_SIGNALS), "arms"])
"""The cell's part of a row; `arms` holds an `ArmRecord` for each arm by its name."""
