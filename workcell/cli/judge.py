"""The command that judges a run: judge."""

from __future__ import annotations

import json
from typing import Annotated

import tyro
from rich.table import Table

from workcell.cli.options import RunFolder
from workcell.cli.terminal import FAILED, OK, stdout


def judge(
    run: RunFolder,
    /,
    cap_m_s: Annotated[
        float | None,
        tyro.conf.arg(metavar="M_S", help="speed cap of support arms; default the scenario's"),
    ] = None,
    json_: Annotated[
        bool, tyro.conf.arg(name="json", help="print JSON instead of a table")
    ] = False,
) -> int:
    """Judge a run by the plant's states alone: contacts and whose, times to collision and whose, deviation, jerk."""
    from workcell.judge import judge_run
    from workcell.judge.table import lines

    verdict = judge_run(run, cap_m_s=cap_m_s)
    if json_:
        stdout.print(json.dumps(verdict.to_json(), indent=2, allow_nan=False), markup=False)
    else:
        table = Table.grid(padding=(0, 2))
        for what, value in lines(verdict):
            table.add_row(what, value)
        stdout.print(table, markup=False)
    return FAILED if verdict.contacts or verdict.short_ticks else OK
