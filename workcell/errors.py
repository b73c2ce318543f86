"""What can go wrong, by name: every error says what was at fault, its value, and what was allowed.

Messages are for people: control characters are written as escapes, long values are shortened in their
middle, and a message as a whole stays under `MESSAGE_LENGTH` characters.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

MESSAGE_LENGTH = 1900
"""Characters of the longest message; chosen to fill no more than one screen."""
FAULT_LENGTH = 700
"""Characters of the longest fault; chosen so that a message holds at least two."""
ORIGIN_LENGTH = 160
"""Characters of a file's name in front of a fault."""
VALUE_LENGTH = 80
"""Characters of a value that is quoted in a fault."""


class WorkcellError(Exception):
    """Base of all errors this package raises on purpose."""


class InputError(WorkcellError):
    """The input was refused before anything ran; the command line turns it into exit status 2.

    Args:
        faults: One line per fault, each naming key, value and what is allowed. All faults that
            could be found are reported at once.
        file: The file (or other origin) the faults are in.
    """

    def __init__(self, faults: str | list[str], *, file: object = None):
        listed = [faults] if isinstance(faults, str) else list(faults)
        self.faults = [shortened(printable(fault), FAULT_LENGTH) for fault in listed]
        self.file = None if file is None else str(file)
        origin = f"{shortened(printable(self.file), ORIGIN_LENGTH)}: " if self.file else ""
        super().__init__(_joined([origin + fault for fault in self.faults]))


class TraceError(WorkcellError):
    """A trace or recording cannot be read as it should: names the file and what is wrong."""


class ControlFault(WorkcellError):
    """A state, target or solution became unusable during a run.

    Args:
        tick: The control tick at which it was seen.
        origin: Which quantity, of which arm, from which stage.
    """

    def __init__(self, tick: int, origin: str):
        self.tick = tick
        self.origin = origin
        super().__init__(f"tick {tick}: {origin}")


@contextmanager
def refused(
    what: str, *kinds: type[BaseException], file: object = None, but: str = ""
) -> Iterator[None]:
    """Turn errors of a library into a refusal of the input that caused them.

    Args:
        what: What was attempted, in the words of the input (key and value), as the subject of a sentence.
        kinds: Kinds of error that the input can cause there; none of them may hide a fault of this package.
        file: The file at fault.
        but: What is allowed, or what to do.

    Raises:
        InputError: one of `kinds` was raised inside.
    """
    try:
        yield
    except WorkcellError:
        raise
    except kinds as error:
        advice = f"; {but}" if but else ""
        raise InputError(f"{what}: {reason(error)}{advice}", file=file) from error


def reason(error: BaseException) -> str:
    """What a library's error says, on one line; the name of the error if it says nothing."""
    if isinstance(error, OSError) and error.strerror:
        where = f": {shown(error.filename)}" if error.filename is not None else ""
        return f"{error.strerror}{where}"
    if isinstance(error, RecursionError):
        return "is nested too deeply"
    if isinstance(error, MemoryError):
        return "needs more memory than there is"
    text = " ".join(str(error).split()).removeprefix("Error: ")
    return shortened(printable(text), FAULT_LENGTH // 2) or type(error).__name__


def shown(value: object) -> str:
    """A value as a message quotes it: its `repr` on one line, shortened."""
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) >= 10**VALUE_LENGTH:
        return f"an integer of more than {VALUE_LENGTH} digits"
    try:
        return shortened(printable(repr(value)), VALUE_LENGTH)
    except (ValueError, RecursionError):  # an integer too long to be written, a nest too deep
        return f"a {type(value).__name__} that is too long to be shown"


def shortened(text: str, length: int) -> str:
    """The text, its middle left out where it is longer than `length` characters."""
    if len(text) <= length:
        return text
    kept = (length - 5) // 2
    return f"{text[:kept]} ... {text[len(text) - kept :]}"


def printable(text: str) -> str:
    """The text with control characters and what no terminal can show as escapes; line breaks become blanks."""
    if text.isprintable():
        return text
    return "".join(
        x if x.isprintable() else " " if x == "\n" else x.encode("unicode_escape").decode("ascii")
        for x in text
    )


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """`; did you mean 'x'?` for the known name nearest to an unknown one; empty if none is near."""
    near = difflib.get_close_matches(name[:VALUE_LENGTH], list(known), n=1)
    return f"; did you mean {near[0]!r}?" if near else ""


def _joined(lines: list[str]) -> str:
    """Lines up to the length of a message, and how many were left out."""
    kept: list[str] = []
    left = MESSAGE_LENGTH
    for line in lines:
        if kept and len(line) + 1 > left:
            kept.append(f"... and {len(lines) - len(kept)} more faults")
            break
        kept.append(line)
        left -= len(line) + 1
    return "\n".join(kept)
