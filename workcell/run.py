"""One scenario -> one trace: the spine of the package, to be read first.

    prepare   scenario -> cell (compiled scene, watched pairs, arms), refused if it cannot be run
    simulate  cell -> trace, tick by tick, with the controller installed as MuJoCo's control callback (`loop.py`)
    conclude  trace -> summary (metrics, expectations with verdicts) and recording

Nothing in the loop reads a clock: time is tick × period, so the same scenario, seed and versions
give the same trace.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

from workcell.admission import STOPPED_BY_CHECK, admit
from workcell.errors import InputError, TraceError
from workcell.files import read_object
from workcell.guard.supervisor import LatchedCheck
from workcell.judge import judge_trace
from workcell.loop import SCENE_FOLDER, Ending, Loop, Watch
from workcell.provenance import layout, origin, versions
from workcell.scenario import Live, Scenario
from workcell.scene.cell import Cell
from workcell.scene.compose import SCENE_FILE
from workcell.trace import metrics
from workcell.trace.expectations import judge
from workcell.trace.preflight import check_space, check_writable, remove_earlier
from workcell.trace.stored import INDEX_NAME
from workcell.trace.table import JOURNAL_NAME, TRACE_NAME, Trace, load
from workcell.trace.why import why
from workcell.trace.writer import FLUSH_S

SCENARIO_FILE = "scenario.toml"
SUMMARY_FILE = "summary.json"
ORIGIN_FILE = "origin.json"
RECORDING_FILE = "recording.rrd"
FIGURES_FOLDER = "figures"
REPORT_FILE = "report.html"
OUTPUTS = (
    TRACE_NAME, JOURNAL_NAME, INDEX_NAME, SUMMARY_FILE, ORIGIN_FILE, RECORDING_FILE, SCENARIO_FILE,
    SCENE_FOLDER, FIGURES_FOLDER, REPORT_FILE, "film.mp4", "film.gif", "film.webp",
    "comparison.txt", "comparison.png", "comparison.rrd",
)  # fmt: skip
"""All that a run and the commands after it write into a run folder."""
CHECK_STOP = STOPPED_BY_CHECK
"""Metric: whether the final check has stopped the arms. A run in which it has is not held, unless `[expect]` says so."""
CONTACT_METRICS = ("contact", "contact_cause", "contacts_by_support")
"""A run with a contact is not held, unless `[expect]` says something of one of these, and it is so."""


def run(
    scenario: Scenario,
    out: Path,
    *,
    progress: Callable[[int, int], None] | None = None,
    phase: Callable[[str], None] | None = None,
) -> dict:
    """Run a scenario into a run folder.

    Args:
        scenario: What to run.
        out: Run folder; made if missing; what an earlier run left in it is removed first.
        progress: Called with (ticks done, ticks of a full run) now and then.
        phase: Called with what begins: preparing, simulating, judging, recording.

    Returns:
        The summary, as written to summary.json.

    Raises:
        InputError: the scenario cannot be run as it is, or another simulation of this process is under way.
    """
    _refuse_live(scenario)
    say = phase or (lambda what: None)
    say("preparing")
    cell = start_folder(scenario, out)
    say("simulating")
    ending = simulate(cell, out, progress=progress)
    return conclude(cell, out, ending, phase=say)


def start_folder(scenario: Scenario, out: Path) -> Cell:
    """A run folder that a run can be written into: its scenario, its scene, where it comes from, and room enough.

    Raises:
        InputError: the scenario cannot be run, or the folder cannot be written to.
    """
    cell = open_folder(scenario, out)
    check_space(out, layout(cell), scenario.ticks)
    (out / SCENARIO_FILE).write_text(scenario.to_toml(), encoding="utf-8")
    (out / ORIGIN_FILE).write_text(json.dumps(origin(cell), indent=2) + "\n", encoding="utf-8")
    return cell


def open_folder(scenario: Scenario, out: Path) -> Cell:
    """Judge a scenario, then make its run folder: what is refused leaves an earlier run as it was.

    Raises:
        InputError: the scenario cannot be run, or the folder cannot be written to.
    """
    with tempfile.TemporaryDirectory() as made:
        cell = prepare(scenario, Path(made))
        begin(out)
        shutil.copytree(made, out / SCENE_FOLDER)
    return cell


def begin(out: Path) -> None:
    """Make the run folder and empty it of what an earlier run left there.

    Raises:
        InputError: the folder cannot be written to.
    """
    check_writable(out)
    remove_earlier(out, OUTPUTS)


def _refuse_live(scenario: Scenario) -> None:
    """Nobody sits at the other end of a headless run."""
    faults = [
        f"arm.{arm.name}.operator.kind = 'live': needs a person; use `workcell teleop`, or give a recording with --set arm.{arm.name}.operator.file=FILE"
        for arm in scenario.arm
        if isinstance(arm.operator, Live)
    ]
    if faults:
        raise InputError(faults, file=scenario.file)


def prepare(scenario: Scenario, folder: Path) -> Cell:
    """Compose the scene into `folder`, compile it and refuse what cannot be run."""
    return admit(scenario, folder).cell


def simulate(
    cell: Cell,
    out: Path,
    *,
    progress: Callable[[int, int], None] | None = None,
    watch: Watch | None = None,
    flush_s: float = FLUSH_S,
    check: LatchedCheck | None = None,
) -> Ending:
    """Step the plant with the controller in its callback; every tick becomes a row of the trace.

    Args:
        cell: What is simulated.
        out: Run folder that holds the scene; the trace is written into it.
        progress: Called with (ticks done, ticks of a full run) now and then.
        watch: Called before every tick; see `workcell.loop.Watch`.
        flush_s: Simulated time of trace that a kill may cost.
        check: A final check that is running already; None starts one in lock-step if the scenario
            wants it.
    """
    with Loop(cell, out, flush_s=flush_s, check=check) as loop:
        loop.run(watch=watch, progress=progress)
    if progress:
        progress(cell.scenario.ticks, cell.scenario.ticks)
    return loop.ending()


def conclude(
    cell: Cell, out: Path, ending: Ending, *, phase: Callable[[str], None] | None = None
) -> dict:
    """Judge the trace, write the summary and derive the recording; `phase` hears which of it begins."""
    say = phase or (lambda what: None)
    # rerun takes half a second to import, which `check` need not wait for
    from workcell.view import recording as view

    say("judging")
    trace = load(out)
    summary = summarise(cell, trace, ending)
    (out / SUMMARY_FILE).write_text(
        json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8"
    )
    say("recording")
    view.record(trace, out / SCENE_FOLDER / SCENE_FILE, out / RECORDING_FILE, summary=summary)
    return summary


def rebuild_recording(out: Path) -> Path:
    """The recording of a run folder, derived anew where it is missing or from another rerun version."""
    from workcell.view import recording as view

    recording, trace, summary = out / RECORDING_FILE, load(out), read_summary(out)
    if not view.is_current(recording, trace, summary=summary):
        view.record(trace, out / SCENE_FOLDER / SCENE_FILE, recording, summary=summary)
    return recording


def read_summary(out: Path) -> dict | None:
    """The summary of a run folder; None where the run was killed before it was written.

    Raises:
        TraceError: it cannot be read.
    """
    path = out / SUMMARY_FILE
    if not path.exists():
        return None
    try:
        return read_object(path)
    except (OSError, ValueError) as error:
        raise TraceError(f"{path}: is damaged: {error}") from error


def summarise(cell: Cell, trace: Trace, ending: Ending) -> dict:
    """Metrics of a run, the verdict on each expectation, and where it all came from."""
    stop = _stop_of_check(ending)
    # Of contact, distances and times the independent judge has the last word, by the plant's states.
    values = (
        metrics.summarise(trace)
        | judge_trace(trace, cell.model).metrics()
        | {
            "fault": ending.fault,
            "interrupted": ending.interrupted,
            CHECK_STOP: stop,
        }
    )
    verdicts = judge(values, cell.scenario.expect)
    held = (
        ending.fault is None
        and not ending.interrupted
        # A stop that the scenario expects is judged like any expectation.
        and (stop in ("off", "none") or CHECK_STOP in verdicts)
        # So is a contact.
        and (not values["contact"] or any(name in verdicts for name in CONTACT_METRICS))
        and all(v["held"] for v in verdicts.values())
    )
    summary = {
        "scenario": cell.scenario.name,
        "scenario_sha256": cell.scenario.digest(),
        "held": held,
        "expectations": verdicts,
        "metrics": values,
        "final_check": ending.check or {"state": "off"},
        "watched_pairs": len(cell.pairs),
        "omitted_pairs": [list(pair) for pair in cell.pairs.omitted],
        "ignored_pairs": [list(pair) for pair in cell.pairs.ignored],
        "notes": list(cell.notes),
        "versions": versions(cell.scenario),
    }
    return summary | {"why": why(trace, summary)}


def _stop_of_check(ending: Ending) -> str:
    """`off`, `none`, or the state in which the final check stopped the arms (docs/final_check.md)."""
    if ending.check is None:
        return "off"
    halt = ending.check["halt"]
    return "none" if halt is None else str(halt["state"])
