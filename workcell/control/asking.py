"""Asking a strategy, and believing nothing it says.

An answer that is missing, has the wrong shape, is not finite or comes too late ends the strategy's turn for the
rest of the run: its arm brakes as hard as its joints can and stays, with the reason `strategy_fault`,
and the run ends with the strategy's name in its summary.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

import numpy as np

from workcell.control import laws
from workcell.control.finite import all_finite
from workcell.control.outcome import MODES
from workcell.control.tick import Steering
from workcell.errors import ControlFault, WorkcellError

TIME_LIMIT_S = 1.0
"""How much processor time a strategy may take for one tick. Chosen a hundred times above the slowest tick of the
built-in ones, so that no machine is too slow for a strategy that works; only a strategy that hangs sees a clock.
What is compiled at a first use takes longer and is no part of it."""
WAIT_LIMIT_S = 8.0
"""How long it may take by the clock on the wall. Chosen for strategies that wait for something; far longer than the
limit above, since a process that a busy machine keeps waiting has done nothing wrong."""


class StrategyFault(WorkcellError):
    """A strategy has not given an answer that can be used."""


def ask(
    name: str, arm: str, answer: Callable[[], Steering], *, n: int, pairs: int, timed: bool
) -> Steering:
    """A strategy's answer, checked.

    Args:
        name: Of the strategy, for the message.
        arm: Whose.
        answer: Calls the strategy.
        n: Joints of the arm.
        pairs: Watched pairs of the cell.
        timed: Whether to interrupt a strategy that hangs; built-in ones do not.

    Raises:
        StrategyFault: The answer cannot be used; the message names strategy, arm and what is wrong.
    """
    try:
        if timed:
            with _time_limit():
                steering = answer()
        else:
            steering = answer()
    except ControlFault:
        raise  # the state itself is broken, which is not the strategy's fault
    except Exception as error:
        raise StrategyFault(
            f"strategy {name!r} of arm {arm} raised {type(error).__name__}: {error}"
        ) from error
    wrong = _wrong(steering, n, pairs)
    if wrong:
        raise StrategyFault(f"strategy {name!r} of arm {arm} answered with {wrong}")
    return steering


def _wrong(steering: Steering, n: int, pairs: int) -> str:
    """What is the matter with an answer; empty if nothing is."""
    if not isinstance(steering, Steering):
        return f"{type(steering).__name__}, must be a Steering"
    checked = None
    for field, value in (
        ("velocity_rad_s", steering.velocity_rad_s),
        ("nominal_rad_s", steering.nominal_rad_s),
    ):
        if value is checked:
            continue  # an arm that nothing slows down
        checked = value
        if not isinstance(value, np.ndarray) or value.shape != (n,):
            return f"{field} of shape {np.shape(value)}, must be ({n},)"
        if not all_finite(value):
            return f"{field} = {value.tolist()}, every entry must be finite"
    for field, share in (("clock_rate", steering.clock_rate), ("scale", steering.scale)):
        if not -1.0 <= share <= 1.0:
            return f"{field} = {share}, must be in [-1, 1]"
    if steering.mode not in MODES:
        return f"mode = {steering.mode!r}, must be one of {', '.join(MODES)}"
    pair = steering.limiting_pair
    if pair is not None and not 0 <= pair < pairs:
        return f"limiting_pair = {pair}, must be None or in [0, {pairs})"
    return ""


@contextmanager
def _time_limit() -> Iterator[None]:
    """Interrupt what takes longer than the limit; in the main thread of a POSIX system, elsewhere nothing is limited.

    The limits begin anew as long as something is compiled: a law's first use must not count as a strategy that hangs.
    """
    if threading.current_thread() is not threading.main_thread() or not hasattr(
        signal, "setitimer"
    ):
        yield
        return

    begun, _ = laws.compilations()
    used_s, since_s = time.thread_time(), time.monotonic()

    def late(_signal: int, _frame: FrameType | None) -> None:
        nonlocal begun, used_s, since_s
        known, (begun, under_way) = begun, laws.compilations()
        if under_way or begun > known:
            used_s, since_s = time.thread_time(), time.monotonic()
        elif time.thread_time() - used_s >= TIME_LIMIT_S:
            raise TimeoutError(f"no answer within {TIME_LIMIT_S:g} s of processor time")
        elif time.monotonic() - since_s >= WAIT_LIMIT_S:
            raise TimeoutError(f"no answer within {WAIT_LIMIT_S:g} s")

    before = signal.signal(signal.SIGALRM, late)
    look_s = TIME_LIMIT_S / 4.0
    signal.setitimer(signal.ITIMER_REAL, TIME_LIMIT_S, look_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
