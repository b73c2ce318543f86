"""`KEY=VALUE` overrides of a parsed scenario file.

A key is dotted. An entry of a list is addressed by its name or its place (`arm.nurse.job.0.dwell_s=1`).
A value is TOML or, failing that, a plain string.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from workcell.errors import VALUE_LENGTH, InputError, did_you_mean, shortened, shown
from workcell.scenario.schema import KINDS

DEEPEST = 16
"""Tables that a dotted key may lead through; the deepest key of a scenario is six deep."""


def apply(content: dict[str, Any], override: str, path: Path) -> None:
    """Set one dotted key in the parsed file.

    Raises:
        InputError: the override is no KEY=VALUE, or its key leads through something that is no table.
    """
    key, separator, text = override.partition("=")
    where = f"--set {shortened(key, VALUE_LENGTH)}"
    if not separator or not key:
        raise InputError(
            f"--set {shown(override)}: allowed is KEY=VALUE with a dotted key of the scenario file",
            file=path,
        )
    *parents, last = key.split(".")
    if len(parents) > DEEPEST:
        raise InputError(f"{where}: leads {len(parents)} tables deep; no key does", file=path)
    value = _value(text)
    node: Any = content
    for part in parents:
        node = _descend(node, part, where, path)
    if isinstance(node, list):
        if last.isdecimal() and int(last) < len(node) and not isinstance(node[int(last)], dict):
            node[int(last)] = value
            return
        raise InputError(
            f"{where}: {last!r} would replace one of several entries; name a key inside it",
            file=path,
        )
    if parents[-1:] == ["operator"] and last in _KIND_OF:
        _become(node, _KIND_OF[last], **{last: _seen_from_here(str(value))})
    elif parents[-1:] == ["operator"] and last == "kind":
        _become(node, str(value))
    else:
        node[last] = value


_KIND_OF = {"file": "recording", "run": "joints"}
"""Keys of an operator that say by themselves of which kind it is."""


def _value(text: str) -> Any:
    """A TOML value or, failing that, the text itself."""
    try:
        parsed = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):  # also what TOML allows and Python cannot hold
        return text
    return parsed["value"] if len(parsed) == 1 else text


def _seen_from_here(file: str) -> str:
    """A file seen from the working folder is that one; any other is relative to the scenario."""
    try:
        here = Path(file)
        return str(here.resolve() if here.exists() else here)
    except (OSError, ValueError):  # no path at all: refused where it is opened
        return file


def _become(operator: dict[str, Any], kind: str, **settings: Any) -> None:
    """Turn a table into an operator of a kind; keys that kind does not have go with the old one."""
    table = KINDS.get(kind)
    kept = {key: x for key, x in operator.items() if table is None or key in table.model_fields}
    operator.clear()
    operator.update(kept | settings, kind=kind)


def _descend(node: Any, part: str, where: str, path: Path) -> Any:
    """What a part of a dotted key leads to: a table or a list."""
    if isinstance(node, dict):
        node = node.setdefault(part, {})
    else:
        names = [_name_of(item, index) for index, item in enumerate(node)]
        if part in names:
            node = node[names.index(part)]
        elif part.isdecimal() and int(part[:9]) < len(node):
            node = node[int(part[:9])]
        else:
            raise InputError(
                f"{where}: no entry {shown(part)}; allowed: {', '.join(names) or 'there is none'}"
                f"{did_you_mean(part, names)}",
                file=path,
            )
    if isinstance(node, (dict, list)):
        return node
    raise InputError(f"{where}: {part!r} is a value, not a table", file=path)


def _name_of(item: Any, index: int) -> str:
    return str(item.get("name", index)) if isinstance(item, dict) else str(index)
