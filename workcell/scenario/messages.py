"""Validation errors in the words of the file: dotted key, value, and what is allowed."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from workcell.errors import did_you_mean, shown
from workcell.scenario.schema import KINDS, Scenario


def messages(error: ValidationError, content: dict[str, Any]) -> list[str]:
    """One line for each fault of a validation, `content` being what the file holds."""
    items = error.errors(include_url=False, include_context=False)
    return [line for item in _roots(items) for line in _fault(item, content)]


def _roots(items: list[Any]) -> list[Any]:
    """Leave out 'too few entries' where entries are missing only because they are at fault themselves."""
    locations = [item["loc"] for item in items]
    return [
        item
        for item in items
        if item["type"] != "too_short"
        or not any(
            len(loc) > len(item["loc"]) and loc[: len(item["loc"])] == item["loc"]
            for loc in locations
        )
    ]


def _fault(item: Any, content: dict[str, Any]) -> Iterator[str]:
    """One validation error in the words of the file: dotted key, value, what is allowed."""
    key: list[str] = []
    node: Any = content
    for part in item["loc"]:
        if isinstance(node, dict) and part in node:
            node = node[part]
            key.append(str(part))
        elif isinstance(node, (list, tuple)) and isinstance(part, int) and part < len(node):
            node = node[part]
            key.append(str(node.get("name", part)) if isinstance(node, dict) else str(part))
        elif item["type"] == "missing":
            key.append(str(part))
    name = ".".join(key) or "scenario"
    if item["type"] == "missing":
        yield f"{name}: this key is missing and has no default"
    elif item["type"] == "extra_forbidden":
        allowed = _allowed(item["loc"])
        yield (
            f"{name} = {shown(node)}: unknown key {key[-1]!r}; allowed here: {', '.join(allowed)}"
            f"{did_you_mean(key[-1], allowed)}"
        )
    else:
        for line in item["msg"].removeprefix("Value error, ").split("\n"):
            # A whole table is no value that could be told in a line.
            yield f"{name}: {line}" if isinstance(node, dict) else f"{name} = {shown(node)}: {line}"


def _allowed(location: tuple[Any, ...]) -> list[str]:
    """The keys allowed in the table that holds the unknown key at `location`."""
    node: Any = Scenario
    for part in location[:-1]:
        if isinstance(part, int):
            continue  # an entry of a list
        if part in KINDS:
            node = KINDS[part]
        elif part in node.model_fields:
            # A table of names (`[expect]`): the name comes next and stands for no table.
            node = _table_in(node.model_fields[part].annotation) or node
    return sorted(node.model_fields)


def _table_in(annotation: Any) -> type[BaseModel] | None:
    """The table behind a key, seen through lists, unions and annotations."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((found for inner in get_args(annotation) if (found := _table_in(inner))), None)
