"""Live tele-operation: a page or a window at one end, a run like any other behind it.

    mouse, keys, gamepad -> marker -> hand -> samples -> live operator -> controller -> trace

Time is the wall clock's, held back to one tick a period; a tick that comes late is counted and
reported. The surface draws in threads of its own, on a model of its own, so that the scene that is
simulated is the one a replay uses. A session is one run, and one more for every reset, each in a
folder of its own.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from workcell import run as runner
from workcell.errors import InputError
from workcell.extras import need
from workcell.live import operator_file, pace
from workcell.live.camera import best_view, presets
from workcell.live.desk import Desk, Say
from workcell.live.report import OperatorReport, operator_report
from workcell.live.sitting import Minutes, Sitting, home, tool_pose
from workcell.live.stream import Stream
from workcell.loop import Ending, final_check
from workcell.scenario import Live, Scenario
from workcell.scene.cell import Cell

LONGEST_S = 4.0 * 3600.0
"""A session ends when the person ends it; this long is a forgotten one."""
NOT_DRIVEN = "Nothing was driven."


@dataclass(frozen=True)
class Session:
    """One run of a session, concluded."""

    folder: Path
    summary: dict[str, Any]
    report: OperatorReport


@dataclass(frozen=True)
class _Attempt:
    """One run of a session, as it ended."""

    cell: Cell
    folder: Path
    ending: Ending
    minutes: Minutes


def teleop(
    scenario: Scenario,
    out: Path,
    *,
    window: bool = False,
    port: int | None = None,
    gamepad: bool = False,
    rerun: bool = False,
    asked_for: Collection[str] = (),
    say: Say = print,
) -> list[Session]:
    """Run a scenario with a person at its live operators, into a run folder.

    Args:
        scenario: At least one arm's operator is of kind `live`.
        out: Run folder of the first run; a reset adds `_2`, `_3`, ...
        window: MuJoCo's window instead of the page in a browser.
        port: Of the page; None for its default.
        gamepad: At the window, also drive with the first gamepad (needs the extra `gamepad`).
        rerun: Also stream to a rerun viewer on this machine, whenever one is there.
        asked_for: Keys of the scenario that the person has set; `simulation.period_s` is then kept even if
            this machine cannot hold it, and `simulation.duration_s` ends the run.
        say: Takes lines for the person.

    Returns:
        The runs that were started, in order, each with its summary, to which `real_time`, `input_latency` and
        `operator_report` are added.

    Raises:
        InputError: no arm is live, the port is taken, or there is no display or gamepad.
    """
    live = [arm.name for arm in scenario.arm if isinstance(arm.operator, Live)]
    if not live:
        raise InputError(
            "no arm has an operator of kind 'live'; set one: --set arm.NAME.operator.kind=live",
            file=scenario.file,
        )
    if window:
        from workcell.live.display import require_display

        require_display()
    choice = pace.choose_period(scenario, keep="simulation.period_s" in asked_for)
    say(choice.said)
    scenario = choice.scenario
    if "simulation.duration_s" not in asked_for:
        scenario = _open_ended(scenario)
    cell = _prepare(scenario, out)
    attempts: list[_Attempt] = []
    with _surface(cell, out, live, window=window, port=port, gamepad=gamepad, say=say) as desk:
        stream = Stream(cell) if rerun else None
        again = True
        while again:
            folder = out if not attempts else out.with_name(f"{out.name}_{len(attempts) + 1}")
            if attempts:
                cell = _prepare(scenario, folder)
            attempt, again = _attempt(cell, folder, desk, stream, live, say)
            attempts.append(attempt)
        if stream:
            stream.close()
        # A run that was never started leaves its scenario and scene, and nothing to sum up.
        sessions = [_conclude(attempt, live) for attempt in attempts if attempt.ending.ticks]
        desk.conclude("\n".join(sessions[-1].report.lines()) if sessions else NOT_DRIVEN)
    return sessions


def _open_ended(scenario: Scenario) -> Scenario:
    """The same scenario for as long as a person likes; its own end is that of a script."""
    duration_s = max(LONGEST_S, scenario.simulation.duration_s)
    simulation = scenario.simulation.model_copy(update={"duration_s": duration_s})
    return scenario.model_copy(update={"simulation": simulation})


def _prepare(scenario: Scenario, folder: Path) -> Cell:
    """A run folder that is begun, and the cell of its run."""
    cell = runner.open_folder(scenario, folder)
    (folder / runner.SCENARIO_FILE).write_text(scenario.to_toml(), encoding="utf-8")
    return cell


@contextmanager
def _surface(
    cell: Cell,
    out: Path,
    live: list[str],
    *,
    window: bool,
    port: int | None,
    gamepad: bool,
    say: Say,
) -> Iterator[Desk]:
    """The page or the window, open while the context lasts."""
    data = home(cell)
    scene_xml = out / runner.SCENE_FOLDER / runner.SCENE_FILE
    poses = {arm.name: tool_pose(data, arm.tool_site) for arm in cell.arms if arm.name in live}
    view = best_view(cell, data, cell.scenario.view)
    if window:
        from workcell.live.window import Window

        with Window(scene_xml, poses, data.qpos, view, gamepad=gamepad) as desk:
            yield desk
        return
    if gamepad:
        raise InputError("--gamepad: belongs to --window; the page reads a gamepad by itself")
    for module in ("viser", "mjviser"):
        need(module, extra="live", what="the page of `workcell teleop`, unlike --window,")
    from workcell.live.page import Page

    options = {} if port is None else {"port": port}
    title = f"workcell: {cell.scenario.name}"
    with Page(scene_xml, poses, presets(view), title=title, say=say, **options) as desk:
        yield desk


def _attempt(
    cell: Cell, folder: Path, desk: Desk, stream: Stream | None, live: list[str], say: Say
) -> tuple[_Attempt, bool]:
    """One run, and whether the person wants another."""
    with final_check(cell, folder, live=True) as check:
        sitting = Sitting(cell, desk, stream, check, live, say)
        ending = runner.simulate(cell, folder, watch=sitting.watch, check=check)
    return _Attempt(cell, folder, ending, sitting.minutes()), sitting.wants_another


def _conclude(attempt: _Attempt, live: list[str]) -> Session:
    """Summary, recording, operator's report and operator files of one run."""
    from workcell.trace.table import load

    folder, minutes = attempt.folder, attempt.minutes
    summary = runner.conclude(attempt.cell, folder, attempt.ending)
    trace = load(folder)
    report = operator_report(trace, live=live, latency=minutes.latency, stopped=minutes.stopped)
    summary |= {
        "real_time": asdict(minutes.real_time),
        "input_latency": asdict(minutes.latency),
        "operator_report": report.as_json(),
    }
    (folder / runner.SUMMARY_FILE).write_text(
        json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8"
    )
    operator_file.write_replay(folder)
    operator_file.write_takes(folder, minutes.takes)
    return Session(folder, summary, report)
