"""One short run of two planar arms, blessed once, for all tests of replaying."""

from pathlib import Path
from typing import NamedTuple

import pytest

from tests import cells
from workcell import run as runner
from workcell import scenario as scenario_file
from workcell.regression import reference as regression
from workcell.regression.bless import bless
from workcell.regression.rows import States, states
from workcell.scene.cell import Cell
from workcell.trace.table import Trace, load

OVERRIDES = ("simulation.period_s=0.02",)


class Duet(NamedTuple):
    scenario: Path
    """File of the scenario."""
    references: Path
    """Folder with its reference and the log."""
    trace: Trace
    """The run the reference was made of."""
    cell: Cell
    states: States
    """What its controller was fed."""

    @property
    def reference(self) -> regression.Reference:
        return regression.load(self.references / "duet")


def duet_content() -> dict:
    content = cells.duet()
    content["simulation"] |= {"duration_s": 5.0, "period_s": 0.02}
    content["check"] = {"enabled": False}
    content["expect"] = {"nurse.scaled_ticks": {"min": 1}}
    return content


@pytest.fixture(scope="session")
def duet(tmp_path_factory) -> Duet:
    folder = tmp_path_factory.mktemp("duet")
    file = cells.write(folder, duet_content())
    references = folder / "references"
    bless(str(file), references, "first", out=folder / "blessed", overrides=OVERRIDES)
    scenario = scenario_file.load(file, OVERRIDES)
    trace = load(folder / "blessed" / "closed_loop")
    cell = runner.prepare(scenario, folder / "scene")
    return Duet(file, references, trace, cell, states(trace))
