"""What can go wrong, by name: every error says what was at fault, its value, and what was allowed."""

from __future__ import annotations


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
        self.faults = [faults] if isinstance(faults, str) else list(faults)
        self.file = None if file is None else str(file)
        origin = f"{self.file}: " if self.file else ""
        super().__init__("\n".join(origin + fault for fault in self.faults))


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
