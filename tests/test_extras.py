"""Optional libraries are named where they are missing; no document installs another project's package."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

import workcell
from workcell.errors import InputError
from workcell.extras import DISTRIBUTION, need

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]


def test_what_is_there_is_imported():
    assert need("json", extra="figures", what="a test").loads("1") == 1


def test_what_is_missing_is_named_with_what_brings_it():
    with pytest.raises(InputError) as caught:
        need("no_such_library", extra="live", what="workcell teleop")
    assert str(caught.value) == (
        "workcell teleop needs no_such_library, which is not installed; pip install 'ttc-workcell[live]'"
    )


def test_every_extra_that_the_code_names_exists_and_all_has_every_extra():
    named = {
        extra
        for file in (ROOT / "workcell").rglob("*.py")
        for extra in re.findall(r"need\([^)]*extra=\"(\w+)\"", file.read_text(encoding="utf-8"))
    }
    assert named
    assert named <= set(EXTRAS)
    (everything,) = EXTRAS["all"]
    assert set(re.findall(r"\w+", everything.removeprefix(DISTRIBUTION))) == set(EXTRAS) - {"all"}


def test_the_distribution_has_one_name_and_the_package_one_version():
    assert PROJECT["name"] == DISTRIBUTION
    assert re.fullmatch(r"\d+\.\d+\.\d+", workcell.__version__)
    told = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    told += sorted((ROOT / "workcell").rglob("*.py"))
    for file in told:
        for line in file.read_text(encoding="utf-8").splitlines():
            if "pip install" in line:
                assert not re.search(r"install\s+'?workcell\b", line), f"{file}: {line}"


def test_the_page_about_installing_lists_every_extra():
    page = (ROOT / "docs" / "install.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^\| `(\w+)` \|", page, flags=re.M)) == set(EXTRAS)
    assert f"ttc_workcell-{workcell.__version__}-" in page
