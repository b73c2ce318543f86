"""Arguments that several commands have, each described once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

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
Workers = Annotated[
    int | None,
    tyro.conf.arg(metavar="N", help="worker processes; default one for each core", name="workers"),
]
Cluster = Annotated[
    str | None,
    tyro.conf.arg(metavar="ADDRESS", help="of a Dask scheduler whose workers make the runs"),
]
