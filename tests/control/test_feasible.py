"""What the joints cannot follow is refused before the first tick, by as much as the run would show."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests import cells
from workcell import run as runner
from workcell.control import feasible
from workcell.control.ik import ArmIk
from workcell.errors import InputError
from workcell.trace.table import load


def swept(speed_m_s: float, **operator: Any) -> dict[str, Any]:
    """The surgeon's tool goes round a bend and back, the nurse stands far off."""
    content = cells.duet()
    content["simulation"] = {"plant": "kinematic", "period_s": 0.02, "duration_s": 12.0}
    content["check"] = {"enabled": False}
    content["arm"][0]["operator"] = {
        "kind": "waypoints",
        "waypoints": [{"position_m": [0.25, 0.5, 0.3]}, {"position_m": [0.45, 0.55, 0.3]}],
        "speed_m_s": speed_m_s,
        "acceleration_m_s2": 2.0,
        "repeat": 1,
        **operator,
    }
    content["arm"][1]["job"] = [{"kind": "wait", "duration_s": 1.0}]
    content["arm"][1]["base_position_m"] = [-2.0, 0.0, 0.0]
    return content


def lag(folder: Path, content: dict[str, Any], *, quick: bool = False) -> float:
    cell = cells.build(folder, content)
    operator = cell.scenario.arm[0].operator
    return feasible.largest_lag(cell, cell.arms[0], operator, quick=quick).error_m  # type: ignore[arg-type]


def test_the_lag_foretold_is_the_one_of_the_run(tmp_path: Path):
    content = swept(0.25)
    foretold = lag(tmp_path, content)
    cell = cells.build(tmp_path, content)
    runner.simulate(cell, tmp_path)
    seen = float(load(tmp_path)["surgeon.tool_error_m"].max())
    assert seen > 1e-3, "the case should ask more of the joints than they can give"
    assert foretold == pytest.approx(seen, rel=1e-6)


def test_an_operator_too_fast_for_its_joints_is_refused_with_a_speed_that_does(tmp_path: Path):
    content = swept(0.6)
    with pytest.raises(InputError) as refusal:
        feasible.check(cells.build(tmp_path, content))
    message = str(refusal.value)
    assert "arm.surgeon.operator.speed_m_s = 0.6: too fast for the joints" in message
    assert "allowed is 20 mm" in message
    speed = float(message.split(" m/s would do")[0].split()[-1])
    assert speed < 0.6
    feasible.check(cells.build(tmp_path / "slower", swept(speed)))


@pytest.mark.parametrize(("speed_m_s", "share"), [(0.1, 0.1), (0.25, 0.5), (0.6, 0.9)])
def test_the_quick_lag_is_the_lag_with_the_program_solved_where_limits_bind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, speed_m_s: float, share: float
):
    solved = []
    solve = ArmIk.solve

    def counted(*given: Any) -> Any:
        solved.append(1)
        return solve(*given)

    monkeypatch.setattr(ArmIk, "solve", counted)
    exact = lag(tmp_path, swept(speed_m_s))
    steps = len(solved)
    assert lag(tmp_path, swept(speed_m_s), quick=True) == pytest.approx(exact, rel=1e-4)
    assert len(solved) - steps < share * steps
