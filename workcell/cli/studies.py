"""The commands that make many runs: sweep, falsify."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.markdown import Markdown

from workcell.cli.options import Cluster, Overrides, ScenarioName, Workers
from workcell.cli.terminal import FAILED, OK, narrow, progress_bar, stderr, stdout


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
        progress_bar(f"sweeping {Path(scenario).stem}") as bar,
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
    narrow.print(Markdown(page.read_text(encoding="utf-8")))
    stdout.print(str(folder))
    if not complete:
        stderr.print("interrupted; --resume goes on")
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
    from workcell.study.vary import load_variations
    from workcell.study.workers import pool

    variations = load_variations(scenario, set)
    folder = out or Path("runs") / f"falsify_{Path(scenario).stem}_{target}"
    with pool(workers, cluster) as (executor, _), progress_bar("searching") as bar:
        case = study.falsify(
            variations, target, folder, executor, runs=runs, seed=seed, limit=limit, progress=bar
        )
    verdict = "FAILS" if case.fails else "none failed; the worst"
    stdout.print(f"{case.tried} runs, {verdict}: {case.scenario.description}")
    for key, value in case.values.items():
        stdout.print(f"  {key} = {value}")
    stdout.print(str(folder / study.CASE_FILE))
    return FAILED if case.fails else OK
