"""One varied run, from its values to a row of numbers.

Comes in: a scenario, concrete. Goes out: an `Outcome`, the same on any machine of a kind, and, for
a run that failed, the files of its run folder. A success is: every job done, nobody touched by the
independent judge (`workcell.judge`), no halt of the final check, no fault. A run ends soon after the
last job is done: what would follow is a person alone.
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from dataclasses import dataclass, fields, replace
from pathlib import Path

import mujoco
import numpy as np

from workcell import run as runner
from workcell.control.controller import Controller
from workcell.errors import InputError
from workcell.judge import Verdict, judge_trace
from workcell.scenario import Scenario
from workcell.trace import metrics
from workcell.trace.table import Trace, load

IMPASSE_S = 2.0
"""An unfinished arm that has made no progress for this long at the end is in an impasse; chosen longer
than any dwell and than an arm needs to brake and start again."""
IMPASSE_PROGRESS = 0.02
"""Progress of the path clock below this share of time is none: at full speed 15 cm/s it is 3 mm/s."""
JOURNAL_S = 10.0
"""Simulated time between writes of a run's journal: a run that is killed is made again, so nothing is lost by few."""
AFTER_DONE_S = 1.0
"""Simulated time a run goes on after its last job is done; chosen as the default t_min."""
WAITING_JOBS = ("wait", "dwell", "done")
"""Jobs in which standing still is what was asked."""


@dataclass(frozen=True)
class Outcome:
    """One run of a study: a row of its table. None where the run has no such thing."""

    run: int
    """Number of the variation, from 0."""
    setting: str
    """Under which setting of `--compare`; empty without."""
    status: str
    """`ran`; `refused` before its first tick; `fault` seen by the controller; `error`, a defect of the
    program; `died` with its worker; `interrupted`, never in a table."""
    reason: str = ""
    """Why it is not `ran`, or why the final check halted it."""
    success: bool = False
    """Jobs done, no contact, no halt, no fault."""
    done: bool = False
    """Whether every support arm has done all its jobs."""
    halted: bool = False
    """Whether the final check has stopped the support arms."""
    impasse: bool = False
    """Whether a support arm stood at the end, jobs undone, unhalted."""
    contact_cause: str = ""
    """Whose motion closed the gap at the first contact: support, priority, both, none; empty: no contact."""
    contact_pair: str | None = None
    """What touched."""
    contact_time_s: float | None = None
    """When, s of simulated time."""
    contact_support_m_s: float | None = None
    """The support arms' part of the closing speed at the contact, m/s."""
    contact_priority_m_s: float | None = None
    """The priority arms' part, m/s."""
    done_s: float | None = None
    """When the last job was done, s of simulated time."""
    smallest_m: float | None = None
    """Smallest high-resolution distance but of tools that are meeting, m."""
    smallest_pair: str | None = None
    """Where."""
    below_d_min: bool = False
    """Whether that one came down to the final check's d_min, at which it halts the arms if it is on."""
    smallest_support_m: float | None = None
    """Smallest high-resolution distance that a support arm's own motion was closing, m."""
    smallest_ttc_s: float | None = None
    """Smallest time to collision from measured velocities, s."""
    smallest_ttc_command_own_s: float | None = None
    """The same from commanded velocities, of what support arms answer for, pair by pair, s."""
    short_ticks: int | None = None
    """Ticks at which what a support arm answers for is below 0.99 of t_min, over all of them."""
    short_reason: str = ""
    """What the support arms say in the worst of these ticks."""
    tool_error_m: float | None = None
    """Largest tool error of a priority arm, m."""
    tool_error_rad: float | None = None
    """The same in angle, rad."""
    deviation_m: float | None = None
    """Largest distance of a support arm's tool from its path, m."""
    jerk_rad_s3: float | None = None
    """Largest commanded joint jerk of a support arm, rad/s^3."""
    jerk_rms_rad_s3: float | None = None
    """Root mean square of it over its joints and the run, rad/s^3."""
    simulated_s: float = 0.0
    """Simulated time, s."""
    wall_s: float = 0.0
    """Time it took, s; differs from machine to machine."""
    peak_memory_mb: float = 0.0
    """Largest memory of the worker process so far, MB; likewise."""


VOLATILE = ("wall_s", "peak_memory_mb")
"""Fields that are not the same on every machine and any number of workers."""
COLUMNS = tuple(field.name for field in fields(Outcome))


@dataclass(frozen=True)
class Report:
    """What comes back from a worker."""

    outcome: Outcome
    """The row."""
    files: dict[str, bytes]
    """Run folder of a failed run, by relative path; empty for a success."""


def perform(run: int, setting: str, scenario: Scenario, keep_failures: bool) -> Report:
    """Make one run in a folder of its own that is gone afterwards.

    Args:
        run, setting: Name the run in its row.
        scenario: What to run.
        keep_failures: Whether a run that failed brings its folder along.
    """
    started = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="workcell_") as temporary:
        folder = Path(temporary)
        outcome = _outcome(run, setting, scenario, folder, keep_failures)
        keep = keep_failures and outcome.status in ("ran", "fault") and not outcome.success
        files = _files(folder) if keep else {}
    cost_s = time.perf_counter() - started
    return Report(replace(outcome, wall_s=cost_s, peak_memory_mb=_peak_memory_mb()), files)


def _outcome(
    run: int, setting: str, scenario: Scenario, folder: Path, keep_failures: bool
) -> Outcome:
    try:
        cell = runner.prepare(scenario, folder / runner.SCENE_FOLDER)
        ending = runner.simulate(cell, folder, watch=_Watch(scenario), flush_s=JOURNAL_S)
    except InputError as error:
        return Outcome(run, setting, "refused", reason="; ".join(error.faults))
    if ending.interrupted:
        return Outcome(run, setting, "interrupted")
    if not ending.ticks:
        return Outcome(run, setting, "fault", reason=ending.fault or "")
    trace = load(folder)
    verdict = judge_trace(trace, cell.model)
    outcome = _measure(run, setting, scenario, trace, ending, verdict)
    if keep_failures and not outcome.success:
        (folder / runner.SCENARIO_FILE).write_text(scenario.to_toml(), encoding="utf-8")
        runner.conclude(cell, folder, ending)
    return outcome


class _Watch:
    """Ends the run some time after its last job is done."""

    def __init__(self, scenario: Scenario):
        self._support = [arm.name for arm in scenario.arm if arm.job]
        self._left = round(AFTER_DONE_S / scenario.simulation.period_s)

    def __call__(self, tick: int, data: mujoco.MjData, controller: Controller) -> bool:
        """See `workcell.run.simulate`."""
        if tick and self._support:
            arms = controller.record.arms
            self._left -= all(arms[name].job == metrics.DONE_JOB for name in self._support)
        return self._left < 0


def _measure(
    run: int,
    setting: str,
    scenario: Scenario,
    trace: Trace,
    ending: runner.Ending,
    verdict: Verdict,
) -> Outcome:
    values = metrics.summarise(trace)
    support = [arm.name for arm in scenario.arm if arm.job]
    priority = [arm.name for arm in scenario.arm if not arm.job]
    done = all(str(trace[f"{arm}.job"][-1]) == "done" for arm in support)
    halt = None if ending.check is None else ending.check["halt"]
    contact, own = verdict.contact, verdict.own
    d_min_m = _check_d_min_m(scenario)
    return Outcome(
        run=run,
        setting=setting,
        status="ran" if ending.fault is None else "fault",
        reason=ending.fault or ("" if halt is None else str(halt["reason"])),
        success=done and halt is None and contact is None and ending.fault is None,
        done=done,
        halted=halt is not None,
        impasse=halt is None
        and ending.fault is None
        and any(stands_at_the_end(trace, arm) for arm in support),
        contact_cause="" if contact is None else contact.cause,
        contact_pair=None if contact is None else " and ".join(contact.pair),
        contact_time_s=None if contact is None else contact.time_s,
        contact_support_m_s=None if contact is None else contact.support_m_s,
        contact_priority_m_s=None if contact is None else contact.priority_m_s,
        done_s=max((done_at_s(trace, arm) for arm in support), default=0.0) if done else None,
        smallest_m=verdict.smallest_m,
        smallest_pair=None
        if verdict.smallest_pair is None
        else " and ".join(verdict.smallest_pair),
        below_d_min=verdict.smallest_m is not None and verdict.smallest_m <= d_min_m,
        smallest_support_m=verdict.smallest_support_m,
        smallest_ttc_s=verdict.measured.ttc_s,
        smallest_ttc_command_own_s=None if own is None else own.ttc_s,
        short_ticks=verdict.short_ticks,
        short_reason=_reason(trace, support, verdict),
        tool_error_m=_largest(values, priority, "max_tool_error_m"),
        tool_error_rad=_largest(values, priority, "max_tool_error_rad"),
        deviation_m=_largest(values, support, "max_tool_error_m"),
        jerk_rad_s3=_largest(values, support, "peak_joint_jerk_rad_s3"),
        jerk_rms_rad_s3=_jerk_rms_rad_s3(trace, support, scenario.simulation.period_s),
        simulated_s=len(trace) * scenario.simulation.period_s,
    )


def _check_d_min_m(scenario: Scenario) -> float:
    """Distance at which the final check halts the arms if it is on."""
    own = scenario.check.d_min_m
    return scenario.control.d_min_m if own is None else own


def _reason(trace: Trace, support: list[str], verdict: Verdict) -> str:
    """Mode and reason of the support arms in the tick whose time to collision was the shortest, where one was short."""
    own = verdict.own
    if not verdict.short_ticks or own is None or own.time_s is None:
        return ""
    tick = int(np.abs(trace["time_s"] - own.time_s).argmin())
    return ", ".join(
        f"{arm}: {trace[f'{arm}.mode'][tick]} {trace[f'{arm}.reason'][tick] or 'no reason'}"
        for arm in support
    )


def stands_at_the_end(trace: Trace, arm: str) -> bool:
    """Whether an arm makes no progress any more although its job asks for it."""
    window = max(1, round(IMPASSE_S / (metrics.period_s(trace) or IMPASSE_S)))
    if len(trace) <= window:
        return False
    job, path_s = trace[f"{arm}.job"][-window:].astype(str), trace[f"{arm}.path_s"][-window:]
    if not (job == job[0]).all() or job[0] in WAITING_JOBS:
        return False
    return abs(float(path_s[-1] - path_s[0])) < IMPASSE_PROGRESS * IMPASSE_S


def done_at_s(trace: Trace, arm: str) -> float:
    """When the arm, whose jobs are done at the end of the trace, was done with them, s."""
    undone = np.flatnonzero(trace[f"{arm}.job"].astype(str) != "done")
    return 0.0 if not undone.size else float(trace["time_s"][undone[-1]])


def _files(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def _jerk_rms_rad_s3(trace: Trace, arms: list[str], period_s: float) -> float | None:
    """Root mean square of the commands' second difference over all joints of some arms."""
    if len(trace) < 3 or not arms:
        return None
    dofs = np.concatenate([np.array(trace.metadata["dofs"][arm], dtype=int) for arm in arms])
    jerk = np.diff(trace["command_rad_s"][:, dofs], 2, axis=0) / period_s**2
    return float(np.sqrt(np.mean(jerk**2)))


def _largest(values: dict[str, metrics.Metric], arms: list[str], name: str) -> float | None:
    found = [_number(values[f"{arm}.{name}"]) for arm in arms]
    return max((x for x in found if x is not None), default=None)


def _number(value: metrics.Metric) -> float | None:
    return float(value) if isinstance(value, (int, float)) else None


def _peak_memory_mb() -> float:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # Kilobytes on Linux, bytes on macOS.
    return peak / (2**20 if sys.platform == "darwin" else 2**10)
