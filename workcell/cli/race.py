"""The command that races strategies against each other: race."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from workcell.cli.options import Cluster, Overrides, Workers
from workcell.cli.terminal import OK, progress_bar, stdout


def race(
    scenarios: Annotated[
        tuple[str, ...],
        tyro.conf.Positional,
        tyro.conf.arg(metavar="SCENARIO", help="names from `workcell list`, or paths"),
    ],
    /,
    strategies: Annotated[
        str, tyro.conf.arg(metavar="A,B,...", help="names from `workcell plugins`")
    ] = "ttc,cbf",
    runs: Annotated[int, tyro.conf.arg(metavar="N", help="variations of each scenario")] = 20,
    seed: Annotated[int, tyro.conf.arg(metavar="S", help="of all draws")] = 0,
    disturbed: Annotated[
        bool, tyro.conf.arg(help="two ticks of latency and sensor noise for every strategy")
    ] = False,
    workers: Workers = None,
    cluster: Cluster = None,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR", help="folder")] = Path("runs/race"),
    resume: Annotated[bool, tyro.conf.arg(help="go on with a race that was stopped")] = False,
    set: Overrides = (),
) -> int:
    """Race strategies: the same variations, the same drives and the same judge for all, in one table."""
    from workcell.study.race import race as study
    from workcell.study.workers import pool

    with pool(workers, cluster) as (executor, count), progress_bar("racing") as bar:
        page = study(
            scenarios,
            strategies.split(","),
            out,
            executor,
            runs=runs,
            seed=seed,
            ahead=2 * count,
            disturbed=disturbed,
            overrides=set,
            resume=resume,
            progress=bar and (lambda name, now: bar(now.done, now.total)),
        )
    stdout.print(page.read_text(encoding="utf-8"), markup=False)
    stdout.print(str(out))
    return OK
