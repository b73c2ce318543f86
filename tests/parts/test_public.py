"""What `import workcell` offers: all that is promised, nothing loaded before it is asked for."""

from __future__ import annotations

import ast
import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

import workcell


def test_every_public_name_is_there_and_typed():
    source = ast.parse(Path(workcell.__file__).read_text(encoding="utf-8"))
    (typed,) = (node for node in source.body if isinstance(node, ast.If))
    named = {
        alias.asname or alias.name: statement.module
        for statement in typed.body
        for alias in statement.names
    }
    assert set(named) | {"__version__"} == set(workcell.__all__)
    assert {name: module for name, (module, _) in workcell._HOME_OF.items()} == named
    for name in workcell.__all__:
        assert getattr(workcell, name) is not None
    assert set(workcell.__all__) <= set(dir(workcell))


def test_importing_it_loads_nothing_heavy():
    told = subprocess.run(
        [sys.executable, "-c", "import sys, workcell; print(sorted({'numpy', 'mujoco', 'numba'} & set(sys.modules)))"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert told.stdout.strip() == "[]"


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'TtcLimits'"):
        workcell.TtcLimits  # noqa: B018
    with pytest.raises(ImportError):
        exec("from workcell import TtcLimits")


def test_every_public_name_is_in_the_reference():
    page = (Path(__file__).parents[2] / "docs" / "api.md").read_text(encoding="utf-8")
    words = set(re.findall(r"\w+", page))
    own = {name: own for name, (_, own) in workcell._HOME_OF.items()}
    missing = [name for name, target in own.items() if target not in words]
    # Values without a docstring page of their own.
    assert missing == ["CRITERIA", "Scenario"]
    for target in re.findall(r"^::: (\S+)", page, flags=re.M):
        module, _, name = target.rpartition(".")
        try:
            importlib.import_module(target)
        except ModuleNotFoundError:
            assert hasattr(importlib.import_module(module), name), target
