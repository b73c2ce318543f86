"""Documentation that repeats a list of the code says the same as the code."""

from __future__ import annotations

import ast
import re
import sys
from pathlib import Path

import pytest
from pydantic import BaseModel

from workcell import scenario
from workcell.cli import COMMANDS
from workcell.signals import ARM_SIGNALS, CELL_SIGNALS
from workcell.trace.metric_names import ARM_METRICS, CELL_METRICS

ROOT = Path(__file__).parents[1]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]

OPERATORS = (
    scenario.Hold, scenario.Waypoints, scenario.Recording, scenario.Human, scenario.Live,
    scenario.Joints, scenario.Plugin,
)  # fmt: skip
JOBS = (
    scenario.Move, scenario.Meet, scenario.Fetch, scenario.Present, scenario.Exchange,
    scenario.Put, scenario.Wait, scenario.Retreat,
)  # fmt: skip
TABLES: dict[str, type[BaseModel]] = {
    **{f"Operator: {table.__name__.lower()}": table for table in OPERATORS},
    **{f"Job: {table.__name__.lower()}": table for table in JOBS},
    **{
        table.__name__: table
        for table in (
            scenario.Scenario, scenario.Simulation, scenario.Control, scenario.Check, scenario.View,
            scenario.Sabotage, scenario.Arm, scenario.Waypoint, scenario.Stream, scenario.Obstacle,
            scenario.Instrument, scenario.Ignore, scenario.Change, scenario.Bound, scenario.Variation,
        )
    },
}  # fmt: skip


def sections(path: Path) -> dict[str, dict[str, list[str]]]:
    """Rows of each section's table, by their first cell."""
    found: dict[str, dict[str, list[str]]] = {}
    for part in re.split(r"^## ", path.read_text(encoding="utf-8"), flags=re.M)[1:]:
        title, _, body = part.partition("\n")
        rows = [
            line.strip("|").split(" | ") for line in body.splitlines() if line.startswith("| `")
        ]
        found[title.strip()] = {r[0].strip(" `"): [c.strip() for c in r[1:]] for r in rows}
    return found


def default(table: type[BaseModel], key: str) -> str:
    """A default as the documentation writes it."""
    field = table.model_fields[key]
    if field.is_required():
        return "needed"
    value = field.get_default(call_default_factory=True)
    if value is None:
        return "–"
    if isinstance(value, BaseModel):
        return "the table's"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, str):
        return f'`"{value}"`'
    return f"`{list(value) if isinstance(value, tuple) else value}`"


def test_every_table_of_the_schema_is_documented():
    defined = {
        table
        for table in vars(scenario).values()
        if isinstance(table, type)
        and issubclass(table, BaseModel)
        and table.__module__.startswith(scenario.__name__)
        and not table.__name__.startswith("_")
    }
    assert set(TABLES.values()) == defined
    assert set(sections(ROOT / "docs" / "scenario.md")) == set(TABLES)


@pytest.mark.parametrize("title", sorted(TABLES))
def test_every_key_of_the_schema_is_documented_with_its_default(title):
    rows = sections(ROOT / "docs" / "scenario.md")[title]
    table = TABLES[title]
    assert set(rows) == set(table.model_fields)
    for key, (written, *_) in rows.items():
        assert written == default(table, key), f"{title}: {key}"


def test_every_column_of_the_trace_is_documented():
    documented = sections(ROOT / "docs" / "trace.md")
    for title, signals in (
        ("Columns of the cell", CELL_SIGNALS),
        ("Columns of each arm", ARM_SIGNALS),
    ):
        wanted = {s.name: [s.unit or "–", s.meaning] for s in signals}
        got = {name: [cells[0], cells[1].rstrip(" |")] for name, cells in documented[title].items()}
        assert got == wanted


def test_every_metric_is_documented():
    documented = sections(ROOT / "docs" / "metrics.md")
    for title, metrics in (
        ("Metrics of the cell", CELL_METRICS),
        ("Metrics of each arm", ARM_METRICS),
    ):
        wanted = {m.name: [m.unit or "–", m.meaning] for m in metrics}
        got = {name: [cells[0], cells[1].rstrip(" |")] for name, cells in documented[title].items()}
        assert got == wanted


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_what_the_documentation_points_at_exists(path):
    text = path.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#\s]+)\)", text):
        if not target.startswith("http"):
            assert (path.parent / target).exists(), target
    for mentioned in re.findall(r"\b((?:docs|mjcf|tests|workcell|scenarios)/[\w/.-]+\.\w+)", text):
        assert (ROOT / mentioned).exists(), mentioned


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_commands_in_the_documentation_exist(path):
    text = path.read_text(encoding="utf-8")
    for command in re.findall(r"^(?:\$ )?workcell ([a-z-]+)|`workcell ([a-z-]+)", text, flags=re.M):
        assert "".join(command) in COMMANDS
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), flags=re.M))
    for target in re.findall(r"^(?:\$ )?make ([a-z-]+)|`make ([a-z-]+)", text, flags=re.M):
        assert "".join(target) in targets


def homes_of_libraries() -> dict[str, set[str]]:
    """Which packages of ours import which other packages; what every part may use is left out."""
    found: dict[str, set[str]] = {}
    own = ROOT / "workcell"
    for file in own.rglob("*.py"):
        if "templates" in file.parts:  # working starts for others, not code of ours
            continue
        place = file.relative_to(own).parts[0]
        home = f"workcell/{place}" + ("" if place.endswith(".py") else "/")
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            modules = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.module and not node.level:
                modules = [node.module]
            for name in {module.partition(".")[0] for module in modules}:
                if name not in {*sys.stdlib_module_names, "workcell", "numpy", "mujoco"}:
                    found.setdefault(name, set()).add(home)
    return found


def test_the_homes_of_libraries_are_told():
    rows = sections(ROOT / "docs" / "architecture.md")["Third parties"]
    told = {name: set(re.findall(r"`(workcell/[^`]+)`", cells[0])) for name, cells in rows.items()}
    assert told == homes_of_libraries()
