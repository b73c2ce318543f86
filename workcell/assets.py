"""Where the shipped arm models and scenarios are, in a checkout and in an installed wheel alike."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).parent
_INSTALLED = _PACKAGE / "_data"  # written by the wheel build, absent in a checkout
_ROOT = _INSTALLED if _INSTALLED.is_dir() else _PACKAGE.parent

MODELS = _ROOT / "mjcf"
SCENARIOS = _ROOT / "scenarios"

LIBRARY_PREFIXES = ("menagerie:", "robot_descriptions:")
"""Of models that come from a library of arms, adapted into the user's cache."""


def model_names() -> list[str]:
    """Names of the shipped arm models, each a folder with an MJCF file of the same name."""
    return sorted(
        path.parent.name for path in MODELS.glob("*/*.xml") if path.stem == path.parent.name
    )


def model_file(name: str) -> Path:
    """The MJCF file of a shipped arm model; it may not exist if the name is unknown."""
    return MODELS / name / f"{name}.xml"


def scenario_names() -> list[str]:
    """Names of the shipped scenarios."""
    return sorted(path.stem for path in SCENARIOS.glob("*.toml"))


def scenario_file(name: str) -> Path:
    """The file of a shipped scenario; it may not exist if the name is unknown."""
    return SCENARIOS / f"{name}.toml"
