"""A scenario file is found, read, overridden and validated, in this order.

Comes in: the name or path of a TOML file and overrides of dotted keys. Goes out: a frozen `Scenario`, or
an error with all faults at once.
"""

from __future__ import annotations

import contextlib
import tomllib
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from workcell import assets
from workcell.errors import InputError, did_you_mean, refused, shown
from workcell.scenario.messages import messages
from workcell.scenario.overrides import apply
from workcell.scenario.schema import Scenario

FILE_BYTES = 4_000_000
"""Of the largest scenario file; chosen a hundred times the largest shipped one."""


def find(scenario: str) -> Path:
    """The file of a scenario given by shipped name or by path.

    Raises:
        InputError: neither a shipped name nor an existing file.
    """
    names = assets.scenario_names()
    if scenario in names:
        return assets.scenario_file(scenario)
    path = Path(scenario)
    with refused(f"scenario {shown(scenario)}", OSError, ValueError, but="allowed is a path"):
        if path.is_file():
            return path
        if path.exists():
            raise InputError(f"scenario {shown(scenario)}: is not a file; allowed is a .toml file")
    raise InputError(
        f"no such scenario: {shown(scenario)}; allowed: a path to a .toml file, or one of {', '.join(names)}"
        f"{did_you_mean(path.stem, names)}"
    )


def load(scenario: str | Path, overrides: tuple[str, ...] = ()) -> Scenario:
    """Read, override and validate a scenario.

    Args:
        scenario: Shipped name or path of a .toml file.
        overrides: `KEY=VALUE` with dotted keys of the file; an arm or obstacle is addressed by its
            name (`arm.nurse.priority=2`), VALUE is TOML or, failing that, a plain string.

    Raises:
        InputError: with every fault found, each naming key, value and what is allowed.
    """
    path = find(str(scenario))
    content = _parsed(path)
    content.setdefault("name", path.stem)
    for override in overrides:
        apply(content, override, path)
    _resolve_models(content, path.parent)
    return validate(content, path)


def _parsed(path: Path) -> dict[str, Any]:
    """The tables of a TOML file."""
    with refused("cannot be read", OSError, file=path), path.open("rb") as file:
        text = file.read(FILE_BYTES + 1)
    if len(text) > FILE_BYTES:
        raise InputError(f"is larger than {FILE_BYTES:,} bytes; no scenario is", file=path)
    # A number of thousands of digits is a ValueError of Python, not of TOML.
    with refused("not valid TOML", ValueError, RecursionError, file=path):
        return tomllib.loads(text.decode("utf-8"))


def validate(content: dict[str, Any], path: Path | None) -> Scenario:
    """The scenario of a parsed file.

    Args:
        content: What the file holds, paths of models resolved.
        path: Where it was read from, for messages.

    Raises:
        InputError: with every fault found, each naming key, value and what is allowed.
    """
    try:
        scenario = Scenario.model_validate(content)
    except ValidationError as error:
        raise InputError(messages(error, content), file=path) from error
    scenario._file = path
    return scenario


def _resolve_models(content: dict[str, Any], folder: Path) -> None:
    """Make relative paths of arm files and recordings absolute; shipped names stay names."""
    arms = content.get("arm")
    for arm in arms if isinstance(arms, list) else []:
        if not isinstance(arm, dict):
            continue
        model = arm.get("model")
        of_library = isinstance(model, str) and model.startswith(assets.LIBRARY_PREFIXES)
        if not of_library and model not in assets.model_names():
            _make_absolute(arm, "model", folder)
        if isinstance(arm.get("operator"), dict):
            for key in ("file", "run"):
                _make_absolute(arm["operator"], key, folder)


def _make_absolute(table: dict[str, Any], key: str, folder: Path) -> None:
    if isinstance(table.get(key), str):
        # What is no path at all stays as it is and is refused by its kind of value.
        with contextlib.suppress(OSError, ValueError):
            table[key] = str((folder / table[key]).resolve())
