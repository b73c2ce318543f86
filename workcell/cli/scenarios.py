"""The commands that look at scenarios without running them: list, check."""

from __future__ import annotations

import tempfile
from pathlib import Path

from rich.table import Table

from workcell import assets
from workcell import scenario as scenario_file
from workcell.cli.arms import check_arm
from workcell.cli.options import Overrides, ScenarioName
from workcell.cli.terminal import OK, stdout


def list_() -> int:
    """List the shipped scenarios with a line about each."""
    table = Table("scenario", "what it shows", box=None)
    for name in assets.scenario_names():
        table.add_row(name, scenario_file.load(name).description)
    stdout.print(table)
    return OK


def check(scenario: ScenarioName, /, set: Overrides = ()) -> int:
    """Check a scenario, or an arm file (.xml, .urdf), without running it: the file, the cell, the start, reach, room to brake, and the final check's geometry."""
    if scenario.endswith((".xml", ".urdf")):
        return check_arm(Path(scenario))
    from workcell.admission import admit
    from workcell.guard.check_setup import left_out
    from workcell.guard.sizing import late_stops
    from workcell.study.vary import Variations

    loaded = scenario_file.load(scenario, set)
    Variations(loaded)  # refuses keys that are not there, and ends of ranges that are not allowed
    with tempfile.TemporaryDirectory() as folder:
        admitted = admit(loaded, Path(folder))
    cell, checker = admitted.cell, admitted.checker
    checked = "off" if checker is None else f"{checker.table.count} pairs of pieces"
    not_checked = [] if checker is None else left_out(checker)
    stdout.print(
        f"{loaded.name}: {len(cell.arms)} arms, {len(cell.pairs)} watched pairs, {len(cell.pairs.omitted)} left out for a reason, final check {checked}, {loaded.ticks} ticks: can be run"
    )
    for note in (*cell.notes, *not_checked, *late_stops(cell)):
        stdout.print(note, markup=False)
    return OK
