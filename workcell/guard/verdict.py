"""What the final check says: a named state, the distance and pair behind it, and how old it is."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class CheckState(StrEnum):
    """Everything but `CLEAR` and `OFF` means: stop."""

    CLEAR = "clear"
    """Every watched pair is farther apart than its smallest allowed distance."""
    HALT = "halt"
    """A pair is too near, or an exempt pair approaches too fast."""
    LATE = "late"
    """The checker runs but has not answered within the deadline."""
    LOST = "lost"
    """The checker process has ended."""
    STOPPED = "stopped"
    """The checker process is suspended (SIGSTOP, a debugger)."""
    STALE = "stale"
    """The newest answer is for a request too old to count."""
    NONSENSE = "nonsense"
    """The answer contradicts itself, the request or arithmetic; or the request was unusable."""
    FAILED_TO_START = "failed_to_start"
    """The checker never became ready."""
    NO_GEOMETRY = "no_geometry"
    """Nothing checked is too near, but an arm has parts the check has no geometry for."""
    OFF = "off"
    """The check is switched off; nothing was looked at."""


@dataclass(frozen=True)
class Verdict:
    """One answer of the final check, or the reason why there is none."""

    state: CheckState
    """What to make of it."""
    sequence: int
    """Number of the request that was answered, from 1; 0 where there is no answer."""
    tick: int
    """Control tick whose configuration was checked; -1 where there is no answer."""
    age_ticks: int
    """Ticks passed since then."""
    distance_m: float | None
    """Smallest distance over the non-exempt pairs, m; the ceiling where all are farther apart;
    None where there is no answer."""
    pair: tuple[str, str] | None
    """Names of the two pieces at that distance (for a halt: of the pair that caused it)."""
    exempt_distance_m: float | None
    """Smallest distance over the pairs exempt at the time, m; None where none are."""
    reason: str
    """One sentence for people."""

    @property
    def must_stop(self) -> bool:
        """True unless the state is `clear` or `off`."""
        return self.state not in (CheckState.CLEAR, CheckState.OFF)
