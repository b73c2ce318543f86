"""The verdict on a run folder: contacts and whose, times to collision and whose, motion; from the plant's states alone."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.errors import TraceError
from workcell.files import require_files
from workcell.judge.approach import SHORT_SHARE, ApproachWatch, Smallest
from workcell.judge.contact import Contact, ContactWatch
from workcell.judge.kinematics import STRETCH, stretch
from workcell.judge.motion import ArmMotion, MotionWatch
from workcell.judge.scene import JudgedScene
from workcell.trace.table import Trace, load

Array = NDArray[np.float64]

SCENE_FILE = Path("scene") / "scene.xml"
CONTACT_LOOK_S = 0.01
"""Time from one look for contact to the next; where a tick is longer, every tick."""


@dataclass(frozen=True)
class Approach:
    """A smallest time to collision, and where it was; None where nothing closed."""

    ttc_s: float | None
    time_s: float | None
    pair: tuple[str, str] | None


@dataclass(frozen=True)
class ArmVerdict:
    """One arm."""

    role: str
    """`support` or `priority`."""
    motion: ArmMotion
    own: Approach | None = None
    """Smallest time to collision that a support arm answers for, by its commands."""
    own_share: float | None = None
    """The smallest of these as a share of the t_min then in force."""
    short_ticks: int | None = None
    """Ticks in which it was below 0.99."""
    forced_ticks: int | None = None
    """Ticks in which only another arm's motion brought a pair below it."""


@dataclass(frozen=True)
class Verdict:
    """What a run amounts to, by the plant's states."""

    source: str
    """The trace."""
    states: str
    """`plant`, or `belief` for a trace from before the plant's state was logged."""
    ticks: int
    period_s: float
    contacts: tuple[Contact, ...]
    """The first touch of each pair of solids that touched, in order."""
    smallest_m: float | None
    """Smallest distance of solids that are not to meet."""
    smallest_pair: tuple[str, str] | None
    smallest_support_m: float | None
    """The smallest within 10 cm that a support arm's own motion was closing."""
    capsules_m: float | None
    """Smallest distance of the watched capsules."""
    capsules_pair: tuple[str, str] | None
    capsules_time_s: float | None
    capsules_apart_m: float | None
    """The same without pairs that are to meet."""
    measured: Approach
    """Smallest time to collision by true velocities."""
    commanded: Approach
    """The same by commanded velocities."""
    arms: dict[str, ArmVerdict]

    @property
    def contact(self) -> Contact | None:
        """The first touch."""
        return self.contacts[0] if self.contacts else None

    @property
    def contacts_by_support(self) -> int:
        """Touching pairs that a support arm's own motion closed."""
        return sum(contact.cause in ("support", "both") for contact in self.contacts)

    @property
    def own(self) -> Approach | None:
        """The smallest time to collision that any support arm answers for."""
        known = [a.own for a in self.arms.values() if a.own is not None and a.own.ttc_s is not None]
        return min(known, key=lambda own: own.ttc_s or 0.0, default=None)

    @property
    def short_ticks(self) -> int:
        """Of all support arms."""
        return sum(arm.short_ticks or 0 for arm in self.arms.values())

    def to_json(self) -> dict[str, Any]:
        """Plain tables and lists."""
        told = asdict(self)
        for table, contact in zip(told["contacts"], self.contacts, strict=True):
            table |= {"cause": contact.cause, "causes": list(contact.causes)}
            del table["support"]
        return told | {"contacts_by_support": self.contacts_by_support}

    def metrics(self) -> dict[str, Any]:
        """In the names of the summary."""
        own = self.own
        return {
            "contact": bool(self.contacts)
            or (self.capsules_m is not None and self.capsules_m <= 0.0),
            "contact_cause": self.contacts[0].cause if self.contacts else None,
            "contacts_by_support": self.contacts_by_support,
            "smallest_distance_m": self.capsules_m,
            "smallest_distance_pair": None
            if self.capsules_pair is None
            else " and ".join(self.capsules_pair),
            "smallest_distance_time_s": self.capsules_time_s,
            "smallest_distance_apart_m": self.capsules_apart_m,
            "smallest_ttc_s": self.measured.ttc_s,
            "smallest_ttc_time_s": self.measured.time_s,
            "smallest_ttc_command_s": self.commanded.ttc_s,
            "smallest_ttc_command_time_s": self.commanded.time_s,
            "smallest_ttc_command_own_s": None if own is None else own.ttc_s,
            "own_short_ticks": self.short_ticks,
        }


def judge_run(folder: Path, *, cap_m_s: float | None = None) -> Verdict:
    """Judge a run folder.

    Args:
        folder: It holds the trace and the scene.
        cap_m_s: Largest speed allowed to the points of support arms; None takes the scenario's.

    Raises:
        TraceError: no trace, no scene, or a trace that does not say which joints are whose.
    """
    trace = load(folder)
    scene_xml = Path(folder) / SCENE_FILE
    if not scene_xml.is_file():
        raise TraceError(f"{folder}: holds no {SCENE_FILE}, without which nothing can be judged")
    try:
        require_files(scene_xml.parent)
        model = mujoco.MjModel.from_xml_path(str(scene_xml))
    except (OSError, ValueError) as error:
        raise TraceError(f"{scene_xml}: is no scene: {error}") from error
    return judge_trace(trace, model, cap_m_s=cap_m_s)


def judge_trace(trace: Trace, model: mujoco.MjModel, *, cap_m_s: float | None = None) -> Verdict:
    """Judge a trace by its compiled scene; see `judge_run`."""
    about = trace.metadata
    if not about.get("settings") or not about.get("dofs"):
        raise TraceError(
            f"{trace.source}: does not say which joints are whose, so it cannot be judged"
        )
    if not len(trace):
        raise TraceError(f"{trace.source}: has no rows to judge")
    scene = JudgedScene(model, about["settings"], about["dofs"])
    states, qpos, qvel = _states(trace)
    time_s, t_min_s, command = trace["time_s"], trace["t_min_s"], trace["command_rad_s"]
    period_s = float(about["settings"]["simulation"]["period_s"])
    pairs = [(first, second) for first, second in trace.layout.pairs]
    meeting = [(first, second) for first, second in about.get("meeting_pairs", [])]
    contact = ContactWatch(scene, meeting, clear_m=about["settings"]["control"]["d_min_m"])
    approach = ApproachWatch(scene, pairs, hands=about.get("hands"), meeting=meeting)
    cap = cap_m_s if cap_m_s is not None else _cap(about["settings"])
    motions = _motions(scene, pairs, cap)
    targets = {arm: trace[f"{arm}.target_position_m"] for arm in scene.arms}
    every, data = max(1, round(CONTACT_LOOK_S / period_s)), mujoco.MjData(model)
    for part, held in _stretches(trace):
        ticks = stretch(
            model, data, time_s[part], t_min_s[part], qpos[part], qvel[part], command[part]
        )
        approach.look(ticks, held)
        for arm, motion in motions.items():
            motion.look(ticks, targets[arm][part])
        for tick in range(part.start, part.stop):
            if tick % every == 0 or tick == len(trace) - 1:
                contact.look(float(time_s[tick]), qpos[tick], qvel[tick], held)
    return Verdict(
        source=str(trace.source),
        states=states,
        ticks=len(trace),
        period_s=period_s,
        contacts=tuple(contact.contacts),
        smallest_m=_finite(contact.smallest_m),
        smallest_pair=contact.smallest_pair,
        smallest_support_m=_finite(contact.smallest_support_m),
        capsules_m=_finite(approach.smallest_m),
        capsules_pair=None if approach.smallest_pair < 0 else pairs[approach.smallest_pair],
        capsules_time_s=None if approach.smallest_pair < 0 else approach.smallest_time_s,
        capsules_apart_m=_finite(approach.apart_m),
        measured=_approach(approach.measured, pairs),
        commanded=_approach(approach.commanded, pairs),
        arms={
            arm: _arm(scene, arm, approach, motions[arm].told(period_s), pairs)
            for arm in scene.arms
        },
    )


def _arm(
    scene: JudgedScene,
    arm: str,
    approach: ApproachWatch,
    motion: ArmMotion,
    pairs: list[tuple[str, str]],
) -> ArmVerdict:
    kept = approach.arms.get(arm)
    if kept is None:
        return ArmVerdict("priority", motion)
    return ArmVerdict(
        "support",
        motion,
        own=_approach(kept.own, pairs),
        own_share=_finite(kept.share),
        short_ticks=kept.short_ticks,
        forced_ticks=kept.forced_ticks,
    )


def _approach(found: Smallest, pairs: list[tuple[str, str]]) -> Approach:
    if not np.isfinite(found.ttc_s):
        return Approach(None, None, None)
    return Approach(found.ttc_s, found.time_s, pairs[found.pair])


def _states(trace: Trace) -> tuple[str, Array, Array]:
    """Where the plant was; where a trace does not say, where the controller believed it to be."""
    if "plant_qpos" in trace.column_names:
        qpos, qvel = trace["plant_qpos"], trace["plant_qvel"]
        if not np.isnan(qpos).any():
            return "plant", qpos, qvel
    return "belief", trace["qpos"], trace["qvel"]


def _motions(
    scene: JudgedScene, pairs: list[tuple[str, str]], cap_m_s: float | None
) -> dict[str, MotionWatch]:
    watched = {scene.model.geom(name).id for pair in pairs for name in pair}
    found = {}
    for arm in scene.arms:
        own = [g for g in sorted(watched) if scene.owner_of(g) == arm]
        cap = cap_m_s if arm in scene.support else None
        found[arm] = MotionWatch(scene, arm, np.array(own, dtype=np.intp), cap)
    return found


def _cap(settings: Mapping[str, Any]) -> float | None:
    """The scenario's cap on the speed of points, if it has one."""
    value = settings["control"].get("point_speed_m_s")
    return None if value is None or not np.isfinite(value) else float(value)


def _stretches(trace: Trace) -> Iterator[tuple[slice, dict[str, str | None]]]:
    """Ticks in a row in which the same arms hold the same instruments, and which."""
    holders = trace["holders"].astype(str)
    changes = np.flatnonzero(holders[1:] != holders[:-1]) + 1
    for start, stop in pairwise([0, *changes.tolist(), len(trace)]):
        parts = (part.partition("=") for part in holders[start].split())
        held: dict[str, str | None] = {item: arm or None for item, _, arm in parts}
        for first in range(start, stop, STRETCH):
            yield slice(first, min(first + STRETCH, stop)), held


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


__all__ = ["SHORT_SHARE", "ArmVerdict", "Verdict", "judge_run", "judge_trace"]
