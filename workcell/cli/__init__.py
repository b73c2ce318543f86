"""The command line: what people type, and nothing else.

Exit status 0: done, and everything expected held. 1: it ran, but a collision, an unexpected halt or
an unmet expectation. 2: the input was refused, with a message that names file, key, value and what
is allowed.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from workcell import assets
from workcell import scenario as scenario_file
from workcell.cli import regression as cli_regression
from workcell.errors import InputError, TraceError

OK, FAILED, REFUSED = 0, 1, 2

ScenarioName = Annotated[
    str,
    tyro.conf.Positional,
    tyro.conf.arg(
        metavar="SCENARIO", help="a name from `workcell list`, or a path to a .toml file"
    ),
]
RunFolder = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN", help="a run folder")]
Overrides = Annotated[
    tyro.conf.UseAppendAction[tuple[str, ...]],
    tyro.conf.arg(
        name="set",
        metavar="KEY=VALUE",
        help="override a dotted key of the scenario file; may be given several times",
    ),
]

_out = Console(highlight=False, soft_wrap=True)
_err = Console(stderr=True, highlight=False, soft_wrap=True)


def list_() -> int:
    """List the shipped scenarios with a line about each."""
    table = Table("scenario", "what it shows", box=None)
    for name in assets.scenario_names():
        table.add_row(name, scenario_file.load(name).description)
    _out.print(table)
    return OK


def check(scenario: ScenarioName, /, set: Overrides = ()) -> int:
    """Check a scenario without running it: the file, the cell, the start, reach, room to brake, and the final check's geometry."""
    from workcell import run as runner
    from workcell.guard.check_setup import try_checker
    from workcell.scene.compose import SCENE_FILE

    loaded = scenario_file.load(scenario, set)
    with tempfile.TemporaryDirectory() as folder:
        cell = runner.prepare(loaded, Path(folder))
        checked = "off"
        if loaded.check.enabled:
            table = try_checker(cell, Path(folder) / SCENE_FILE).table
            checked = f"{table.count} pairs of pieces"
    _out.print(
        f"{loaded.name}: {len(cell.arms)} arms, {len(cell.pairs)} watched pairs, {len(cell.pairs.omitted)} left out for a reason, final check {checked}, {loaded.ticks} ticks: can be run"
    )
    return OK


def run(
    scenario: ScenarioName,
    /,
    out: Annotated[
        Path | None, tyro.conf.arg(metavar="DIR", help="run folder; default runs/<scenario>")
    ] = None,
    set: Overrides = (),
) -> int:
    """Run a scenario headlessly into a run folder and judge it by its expectations."""
    from workcell import run as runner

    loaded = scenario_file.load(scenario, set)
    folder = out or Path("runs") / loaded.name
    with _progress(f"running {loaded.name}") as progress:
        summary = runner.run(loaded, folder, progress=progress)
    _report(summary, folder)
    return OK if summary["held"] else FAILED


def teleop(
    scenario: ScenarioName,
    /,
    out: Annotated[
        Path | None, tyro.conf.arg(metavar="DIR", help="run folder; default runs/<scenario>_live")
    ] = None,
    set: Overrides = (),
    gamepad: Annotated[
        bool, tyro.conf.arg(help="steer with the first gamepad or 3D mouse too")
    ] = False,
    rerun: Annotated[
        bool, tyro.conf.arg(help="also stream to a rerun viewer on this machine, when there is one")
    ] = False,
) -> int:
    """Run a scenario in real time with a person at its live operators; docs/teleop.md has the keys."""
    from workcell.live.teleop import teleop as session

    loaded = scenario_file.load(scenario, set)
    folder = out or Path("runs") / f"{loaded.name}_live"
    summary = session(loaded, folder, gamepad=gamepad, rerun=rerun, say=_out.print)
    _report(summary, folder)
    kept = summary["real_time"]
    _out.print(
        f"real time: {kept['missed']} of {kept['ticks']} ticks came late, the worst by {1e3 * kept['worst_late_s']:.1f} ms; {kept['slipped_s']:.2f} s slower than the clock"
    )
    return OK if summary["held"] else FAILED


def record_operator(run: RunFolder, /) -> int:
    """Write the operators of a run as recordings, and replay.toml, which plays them back."""
    from workcell.live.operator_file import write_replay

    for path in write_replay(run):
        _out.print(str(path))
    return OK


def replay(
    run: RunFolder,
    /,
    web: Annotated[bool, tyro.conf.arg(help="in a browser instead of the native viewer")] = False,
) -> int:
    """Open a run in the rerun viewer; its recording is rebuilt from the trace where it is missing or outdated."""
    from workcell.run import rebuild_recording
    from workcell.view import recording as view

    recording = rebuild_recording(run)
    return OK if view.open_viewer(recording, web=web).wait() == 0 else FAILED


def plot(run: RunFolder, /) -> int:
    """Draw the paper's figures 3, 4 and 5 from a run into its folder `figures`."""
    from workcell.run import SCENE_FOLDER
    from workcell.trace.table import load
    from workcell.view import figures

    for path in figures.paper_figures(load(run), run / SCENE_FOLDER / "scene.xml", run / "figures"):
        _out.print(str(path))
    return OK


Workers = Annotated[
    int | None,
    tyro.conf.arg(metavar="N", help="worker processes; default one for each core", name="workers"),
]
Cluster = Annotated[
    str | None,
    tyro.conf.arg(metavar="ADDRESS", help="of a Dask scheduler whose workers make the runs"),
]


def sweep(
    scenario: ScenarioName,
    /,
    runs: Annotated[int, tyro.conf.arg(metavar="N", help="variations")] = 100,
    seed: Annotated[int, tyro.conf.arg(metavar="S", help="of all draws")] = 0,
    compare: Annotated[
        tyro.conf.UseAppendAction[tuple[str, ...]],
        tyro.conf.arg(
            metavar="KEY=A,B,...",
            help="try the same variations under each of these; may be given several times",
        ),
    ] = (),
    workers: Workers = None,
    cluster: Cluster = None,
    out: Annotated[
        Path | None, tyro.conf.arg(metavar="DIR", help="folder; default runs/sweep_<scenario>")
    ] = None,
    resume: Annotated[bool, tyro.conf.arg(help="go on with a sweep that was stopped")] = False,
    set: Overrides = (),
) -> int:
    """Make many variations of a scenario, as its [vary] says, and sum up how often they fail."""
    from workcell.study import report
    from workcell.study import sweep as study
    from workcell.study.workers import pool

    plan = study.plan(scenario, runs=runs, seed=seed, compare=compare, overrides=set)
    folder = out or Path("runs") / f"sweep_{Path(scenario).stem}"
    options = {"runs": runs, "seed": seed, "compare": compare, "set": set}
    with (
        pool(workers, cluster) as (executor, count),
        _progress(f"sweeping {Path(scenario).stem}") as bar,
    ):
        complete = study.sweep(
            plan,
            folder,
            executor,
            ahead=2 * count,
            resume=resume,
            progress=bar and (lambda now: bar(now.done, now.total)),
        )
    page = report.conclude(folder, report.command_line("sweep", scenario, options))
    _out.print(page.read_text(encoding="utf-8"), markup=False)
    _out.print(str(folder))
    if not complete:
        _err.print("interrupted; --resume goes on")
    return OK if complete and report.all_succeeded(folder) else FAILED


def falsify(
    scenario: ScenarioName,
    /,
    target: Annotated[
        Literal["distance", "ttc", "tool_error", "impasse"],
        tyro.conf.arg(help="what the worst case is worst in"),
    ] = "distance",
    runs: Annotated[int, tyro.conf.arg(metavar="N", help="runs of the search")] = 160,
    seed: Annotated[int, tyro.conf.arg(metavar="S", help="of the search")] = 0,
    limit: Annotated[
        float | None,
        tyro.conf.arg(help="beyond which a run fails, in m or s; default the law's own"),
    ] = None,
    workers: Workers = None,
    cluster: Cluster = None,
    out: Annotated[
        Path | None,
        tyro.conf.arg(metavar="DIR", help="folder; default runs/falsify_<scenario>_<target>"),
    ] = None,
    set: Overrides = (),
) -> int:
    """Search the variations of a scenario for one that breaks the controller, and shrink what is found to a small scenario."""
    from workcell.study import falsify as study
    from workcell.study.vary import Variations
    from workcell.study.workers import pool

    variations = Variations(scenario_file.load(scenario, set))
    folder = out or Path("runs") / f"falsify_{Path(scenario).stem}_{target}"
    with pool(workers, cluster) as (executor, _), _progress("searching") as bar:
        case = study.falsify(
            variations, target, folder, executor, runs=runs, seed=seed, limit=limit, progress=bar
        )
    verdict = "FAILS" if case.fails else "none failed; the worst"
    _out.print(f"{case.tried} runs, {verdict}: {case.scenario.description}", markup=False)
    for key, value in case.values.items():
        _out.print(f"  {key} = {value}", markup=False)
    _out.print(str(folder / study.CASE_FILE))
    return FAILED if case.fails else OK


def compile_() -> int:
    """Compile the arithmetic of a tick for this machine, once; without it, NumPy is used and a tick takes twice as long."""
    from workcell.control.kernels.build import compile_kernels

    try:
        _out.print(str(compile_kernels()))
    except OSError as error:
        _err.print(f"cannot keep what was compiled: {error}", markup=False)
        return FAILED
    return OK


def _report(summary: dict, folder: Path) -> None:
    table = Table("expectation", "wanted", "measured", "held", box=None)
    for name, verdict in summary["expectations"].items():
        table.add_row(
            name,
            verdict["wanted"],
            verdict["measured"],
            "yes" if verdict["held"] else "[red]NO[/red]",
        )
    if summary["expectations"]:
        _out.print(table)
    halt = summary["final_check"].get("halt")
    if halt:
        _err.print(f"stopped by the final check, {halt['state']}: {halt['reason']}", markup=False)
    if summary["metrics"]["fault"]:
        _err.print(f"stopped: {summary['metrics']['fault']}", markup=False)
    _out.print(
        f"{summary['scenario']}: {'all expectations held' if summary['held'] else 'NOT as expected'}; {folder}"
    )


@contextmanager
def _progress(what: str) -> Iterator[Callable[[int, int], None] | None]:
    """A progress bar on a terminal, nothing elsewhere."""
    if not _err.is_terminal:
        yield None
        return
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f}%"),
        TimeRemainingColumn(),
        console=_err,
    ) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


COMMANDS: dict[str, Callable[..., int]] = {
    "list": list_,
    "check": check,
    "run": run,
    "teleop": teleop,
    "record-operator": record_operator,
    "replay": replay,
    "plot": plot,
    "sweep": sweep,
    "falsify": falsify,
    "compare": cli_regression.compare,
    "rerun": cli_regression.rerun,
    "bless": cli_regression.bless,
    "salvage": cli_regression.salvage,
    "compile": compile_,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the `workcell` command; returns the exit status."""
    try:
        return tyro.extras.subcommand_cli_from_dict(
            COMMANDS, prog="workcell", args=arguments, description=__doc__
        )
    except (InputError, TraceError) as error:
        _err.print(str(error), markup=False)
        return REFUSED
    except KeyboardInterrupt:
        _err.print("interrupted")
        return FAILED


if __name__ == "__main__":
    sys.exit(main())
