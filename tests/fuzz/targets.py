"""The kinds of input that are mutated, and the commands that must take them or refuse them."""

from __future__ import annotations

import tomllib
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import tomli_w

from tests import cells
from tests.fuzz import mutate
from tests.fuzz.harness import Case, Target
from workcell import assets

SHORT = ("--set", "simulation.duration_s=0.16")
"""A run of some ticks: enough for everything that is opened, made and judged before and after."""


@cache
def _scenarios() -> tuple[dict[str, Any], ...]:
    """What mutations start from: the shipped scenarios, and small cells twice as often."""
    shipped = [
        tomllib.loads(assets.scenario_file(name).read_text(encoding="utf-8"))
        for name in assets.scenario_names()
    ]
    small = [cells.duet(), cells.duet(t_min_s=1.0, criterion="armd")]
    return (*shipped, *small * len(shipped))


def scenario(case: Case, folder: Path) -> None:
    """A scenario file: `check` takes or refuses it, and `run` does not refuse what `check` took."""
    random = Random(case.seed)
    content = random.choice(_scenarios())
    path = folder / "mutated.toml"
    overrides: list[str] = []
    if random.random() < 0.25:
        text = tomli_w.dumps(content).encode()
        path.write_bytes(mutate.damaged(random, text))
    elif random.random() < 0.2:
        path.write_text(tomli_w.dumps(content), encoding="utf-8")
        overrides = ["--set", f"{_dotted(random, content)}={random.choice(mutate.UGLY)}"]
    else:
        changed = mutate.tables(random, content, random.choice((1, 1, 2, 4)))
        try:
            path.write_text(tomli_w.dumps(changed), encoding="utf-8")
        except (TypeError, ValueError):  # what TOML cannot hold is no scenario file
            return
    _check_and_run(case, random, path, overrides)


def _check_and_run(case: Case, random: Random, path: Path, overrides: list[str]) -> None:
    checked = case.call("check", str(path), *overrides)
    if checked.status == 0 and random.random() < 0.3:
        short = (*overrides, *SHORT)
        if case.call("check", str(path), *short).status == 0:
            ran = case.call("run", str(path), "--out", "run", *short)
            if ran.status == 2:
                case.faults.append(f"run refused what check had passed: {ran.err[:300]}")


def _dotted(random: Random, content: Any) -> str:
    """A dotted key into the file, now and then with a typing error."""
    parts: list[str] = []
    node: Any = content
    while isinstance(node, (dict, list)) and node and random.random() < 0.9:
        if isinstance(node, dict):
            part = random.choice(list(node))
            node = node[part]
        else:
            index = random.randrange(len(node))
            part, node = str(index), node[index]
        parts.append(part)
    key = ".".join(parts)
    return mutate.typing_error(random, key) if random.random() < 0.2 else key


TARGETS: dict[str, Target] = {"scenario": scenario}
