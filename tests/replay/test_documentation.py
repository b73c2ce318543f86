"""The recipes of docs/regression.md, as they are printed there."""

import importlib.util
import re
from pathlib import Path

import pytest

from workcell.control.controller import Controller

PAGE = Path(__file__).parents[2] / "docs" / "regression.md"


def recipe(word):
    (found,) = (
        code
        for code in re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
        if word in code
    )
    return found


def test_reading_a_trace(duet):
    names = {}
    code = recipe("to_pandas").replace("runs/handover", str(duet.trace.source.parent))
    lines = code.splitlines()
    if importlib.util.find_spec("pandas") is None:  # It is the reader's to install, not ours.
        lines = [line for line in lines if "to_pandas" not in line]
    exec("\n".join(lines), names)
    assert names["trace"].table.num_rows == len(duet.trace)


@pytest.mark.parametrize("factor", [1.0, 1.01])
def test_my_own_controller(duet, capsys, factor):
    controller = Controller(duet.cell)

    def my_controller(qpos, qvel):
        return factor * controller.step(qpos, qvel).command_rad_s

    code = recipe("my_controller").replace(
        "tests/replay/references/handover", str(duet.references / "duet")
    )
    exec(code, {"my_controller": my_controller})
    said = capsys.readouterr().out
    assert said.startswith("first differing tick: ")
    assert ("None" in said) == (factor == 1.0)
