"""What the final check is told: which arms, how near is too near, how long an answer may take.

Comes in from the scenario and goes, as one line of JSON, to the checker process, so that both
sides work from the same numbers. Halt condition: d <= d_min (paper, section VI). Times that
belong to the simulation are counted in ticks; times that a process may take are seconds of the
wall clock, and no number that reaches a trace depends on the latter unless it has failed.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, field

from workcell.errors import InputError

DEADLINE_S = 0.05
"""Live deadline. Chosen as about a hundred times the median of a check, above the scheduling pauses of
an ordinary desktop, and below what an arm at 0.25 m/s needs for 15 mm."""
FAULT_KINDS = (
    "crash_at_start",
    "hang_at_start",
    "slow",
    "old_sequence",
    "future_sequence",
    "not_a_number",
    "garbage",
    "kill_self",
    "stop_self",
)


@dataclass(frozen=True)
class Exemption:
    """A pair that is meant to meet, and the terms on which it may.

    Outside its window (see `FinalCheck.open_exemption`) it is a pair like any other.
    """

    name: str
    """How the window is opened and closed."""
    geoms_i: tuple[str, ...]
    """One side: names of geoms or bodies, or shell patterns of them (`nurse/tool*`)."""
    geoms_j: tuple[str, ...]
    """The other side, likewise."""
    expiry_s: float
    """An open window closes by itself this long after it was opened, s of simulated time."""
    max_closing_m_s: float
    """Inside the window a faster approach of the pair halts, m/s, where it is `near_m` or nearer."""
    d_min_m: float
    """Inside the window the pair halts at this distance instead of the check's own, m; may be
    negative for a soft or form-fitting contact."""
    near_m: float = math.inf
    """Distance from which the cap on the closing speed counts, m: chosen with room to stop in."""


@dataclass(frozen=True)
class Held:
    """A loose body that arms can hold: watched against everything but what holds it.

    Which arm that is comes with every request; an instrument nobody holds is let off nothing
    but what it rests on.
    """

    name: str
    """Its body in the scene."""
    rests_on: tuple[str, ...] = ()
    """Geoms it lies on and is never watched against."""


@dataclass(frozen=True)
class TestFault:
    """A fault the checker commits on purpose, so that tests can see the answer to it."""

    __test__ = False  # The name is not that of a test class.

    kind: str
    """One of FAULT_KINDS."""
    from_sequence: int = 1
    """The first request (they count from 1) that is answered faultily."""
    seconds: float = 0.0
    """How long `slow` takes, s."""


@dataclass(frozen=True)
class CheckSettings:
    """Everything the check needs beside the scene file. Refuses impossible values by name."""

    arms: tuple[str, ...]
    """Names of the arms; what belongs to an arm is named `<arm>/...` in the scene."""
    d_min_m: float
    """Halt at this distance between high-resolution pieces, m."""
    period_s: float
    """Length of one control tick, s of simulated time."""
    every_ticks: int = 5
    """In lock-step, one check every so many ticks. Chosen for 2 ms ticks: at a closing speed of
    0.25 m/s a pair moves 2.5 mm between checks, half of a 5 mm d_min."""
    ceiling_m: float = 0.5
    """Distances beyond this are reported as this, m. Chosen well above any d_min, yet small
    enough that most pairs of a cell are dismissed by their bounding spheres."""
    deadline_s: float = DEADLINE_S
    """Live: an answer that takes longer stops the arms, s."""
    lockstep_deadline_s: float = 5.0
    """Headless, and live for the first answer, before which nothing moves: longest wait, s. Simulated
    time stands still meanwhile, so it only has to end a run that would hang; chosen to survive a busy
    build machine."""
    start_deadline_s: float = 30.0
    """Longest wait for the checker to load the scene, s. Chosen for a cold disk cache."""
    max_age_ticks: int = 25
    """Live: an answer older than this many ticks no longer counts. The default is `deadline_s` at 2 ms
    ticks, so that neither clock hides a slow checker from the other; a run sets it by its own period."""
    exemptions: tuple[Exemption, ...] = ()
    """Pairs that may meet inside a declared window."""
    instruments: tuple[Held, ...] = ()
    """Loose bodies that arms can hold."""
    hands: tuple[tuple[str, ...], ...] = ()
    """For each of `arms`, the bodies that touch what it holds; needed if there are instruments."""
    ignored: tuple[tuple[str, str, str], ...] = ()
    """Pairs of geoms or bodies, by name, that are not held apart, each with the user's reason."""
    home: tuple[float, ...] = ()
    """(nq,) positions of all joints at the start, which decide with others what overlaps by design."""
    release_s: float = 60.0
    """Longest time after it has given an instrument away that a hand may still touch it, s of
    simulated time; it ends as soon as the two are clear. Chosen longer than any retreat."""
    clear_m: float | None = None
    """Distance beyond which they are, m; None for `d_min_m`."""
    enabled: bool = True
    """False: no process is started, every verdict is `off`."""
    test_fault: TestFault | None = field(default=None)
    """For the tests of the fail-safe only."""

    def __post_init__(self) -> None:
        faults = _number_faults(self)
        if not self.arms:
            faults.append("arms: () is empty; name at least one arm")
        if self.instruments and len(self.hands) != len(self.arms):
            faults.append(
                f"hands: {len(self.hands)} are named for {len(self.arms)} arms; name one an arm"
            )
        names = [exemption.name for exemption in self.exemptions]
        for name in sorted({name for name in names if names.count(name) > 1}):
            faults.append(f"exemptions: the name '{name}' is used more than once")
        for exemption in self.exemptions:
            faults.extend(_exemption_faults(exemption))
        if self.test_fault is not None and self.test_fault.kind not in FAULT_KINDS:
            allowed = ", ".join(FAULT_KINDS)
            faults.append(f"test_fault.kind: '{self.test_fault.kind}' is not one of {allowed}")
        if faults:
            raise InputError(faults)

    def exemption_index(self, name: str) -> int:
        """Position of a named exemption.

        Raises:
            InputError: If there is none of that name.
        """
        for index, exemption in enumerate(self.exemptions):
            if exemption.name == name:
                return index
        known = ", ".join(exemption.name for exemption in self.exemptions) or "none are declared"
        raise InputError(f"exemption '{name}' is unknown; declared: {known}")

    def instrument_index(self, name: str) -> int:
        """Position of a named instrument.

        Raises:
            InputError: If there is none of that name.
        """
        names = [item.name for item in self.instruments]
        if name not in names:
            known = ", ".join(names) or "none are declared"
            raise InputError(f"instrument '{name}' is unknown; declared: {known}")
        return names.index(name)

    def arm_index(self, name: str) -> int:
        """Position of a named arm.

        Raises:
            InputError: If there is none of that name.
        """
        if name not in self.arms:
            raise InputError(f"arm '{name}' is unknown; allowed: {', '.join(self.arms)}")
        return self.arms.index(name)

    def expiry_ticks(self, index: int) -> int:
        """How many ticks the window of exemption `index` may stay open."""
        return max(1, round(self.exemptions[index].expiry_s / self.period_s))

    def to_json(self) -> str:
        """One line that `from_json` turns back into equal settings."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> CheckSettings:
        """Inverse of `to_json`."""
        fields = json.loads(text)
        fields["arms"] = tuple(fields["arms"])
        fields["home"] = tuple(fields["home"])
        fields["ignored"] = tuple(tuple(entry) for entry in fields["ignored"])
        exemptions = []
        for item in fields["exemptions"]:
            sides = {side: tuple(item.pop(side)) for side in ("geoms_i", "geoms_j")}
            exemptions.append(Exemption(**sides, **item))
        fields["exemptions"] = tuple(exemptions)
        fields["instruments"] = tuple(
            Held(item["name"], tuple(item["rests_on"])) for item in fields["instruments"]
        )
        fields["hands"] = tuple(tuple(bodies) for bodies in fields["hands"])
        if fields["test_fault"] is not None:
            fields["test_fault"] = TestFault(**fields["test_fault"])
        return cls(**fields)


def _number_faults(settings: CheckSettings) -> list[str]:
    positive = (
        "period_s",
        "ceiling_m",
        "deadline_s",
        "lockstep_deadline_s",
        "start_deadline_s",
        "release_s",
    )
    faults = [
        f"{name}: {getattr(settings, name)} must be finite and above 0"
        for name in positive
        if not (math.isfinite(getattr(settings, name)) and getattr(settings, name) > 0.0)
    ]
    faults += [
        f"{name}: {getattr(settings, name)} must be a whole number of at least 1"
        for name in ("every_ticks", "max_age_ticks")
        if not (isinstance(getattr(settings, name), int) and getattr(settings, name) >= 1)
    ]
    if settings.clear_m is not None and not (
        math.isfinite(settings.clear_m) and settings.clear_m >= 0.0
    ):
        faults.append(f"clear_m: {settings.clear_m} must be finite and at least 0, or None")
    # Contact must always halt, and a d_min at or above the ceiling would halt for ever.
    if not (math.isfinite(settings.d_min_m) and 0.0 <= settings.d_min_m < settings.ceiling_m):
        faults.append(
            f"d_min_m: {settings.d_min_m} must be at least 0 and below ceiling_m "
            f"({settings.ceiling_m})"
        )
    return faults


def _exemption_faults(exemption: Exemption) -> list[str]:
    key = f"exemptions.{exemption.name}"
    faults = [
        f"{key}.{name}: {getattr(exemption, name)} must be finite and above 0"
        for name in ("expiry_s", "max_closing_m_s")
        if not (math.isfinite(getattr(exemption, name)) and getattr(exemption, name) > 0.0)
    ]
    faults += [
        f"{key}.{side}: () names no geom or body"
        for side in ("geoms_i", "geoms_j")
        if not getattr(exemption, side)
    ]
    if not exemption.near_m > 0.0:
        faults.append(f"{key}.near_m: {exemption.near_m} must be above 0")
    if not math.isfinite(exemption.d_min_m):
        faults.append(f"{key}.d_min_m: {exemption.d_min_m} must be finite")
    return faults
