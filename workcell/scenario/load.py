"""A scenario file is found, read, overridden and validated, in this order.

Comes in: the name or path of a TOML file and overrides of dotted keys. Goes out: a frozen `Scenario`, or
an error with all faults at once.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from workcell import assets
from workcell.errors import InputError
from workcell.scenario.messages import messages
from workcell.scenario.overrides import apply
from workcell.scenario.schema import Scenario


def find(scenario: str) -> Path:
    """The file of a scenario given by shipped name or by path.

    Raises:
        InputError: neither a shipped name nor an existing file.
    """
    if assets.scenario_file(scenario).is_file():
        return assets.scenario_file(scenario)
    path = Path(scenario)
    if path.is_file():
        return path
    raise InputError(
        f"no such scenario: {scenario!r}; allowed: a path to a .toml file, or one of {', '.join(assets.scenario_names())}"
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
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"not valid TOML: {error}", file=path) from error
    content.setdefault("name", path.stem)
    for override in overrides:
        apply(content, override, path)
    _resolve_models(content, path.parent)
    return validate(content, path)


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
        model = arm.get("model") if isinstance(arm, dict) else None
        if isinstance(model, str) and model not in assets.model_names():
            arm["model"] = str((folder / model).resolve())
        operator = arm.get("operator") if isinstance(arm, dict) else None
        for key in ("file", "run"):
            path = operator.get(key) if isinstance(operator, dict) else None
            if isinstance(operator, dict) and isinstance(path, str):
                operator[key] = str((folder / path).resolve())
