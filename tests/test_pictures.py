"""The pictures of README and docs show what the program does today: `make pictures` makes them anew."""

from __future__ import annotations

import hashlib
import importlib.util
import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
IMAGES = ROOT / "docs" / "images"
STAMPS = json.loads((IMAGES / "stamps.json").read_text(encoding="utf-8"))
OF_STUDIES = {"criteria.png"}
"""Pictures of studies that take hours; docs/results.md dates them."""


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize("name", STAMPS)
def test_a_picture_is_of_the_behaviour_that_the_reference_keeps(name):
    stamp = STAMPS[name]
    reference = ROOT / "tests" / "replay" / "references" / stamp["scenario"] / "closed_loop.csv"
    assert stamp["reference_sha256"] == digest(reference), f"{name} is stale: make pictures"
    assert stamp["picture_sha256"] == digest(IMAGES / name), f"{name} is not the one that was made"


def test_every_picture_has_a_stamp():
    pictures = {p.name for p in IMAGES.iterdir() if p.suffix in (".png", ".webp", ".gif", ".mp4")}
    assert pictures == set(STAMPS) | OF_STUDIES
    used = "".join(
        p.read_text(encoding="utf-8") for p in [ROOT / "README.md", *ROOT.glob("docs/*.md")]
    )
    assert {Path(x).name for x in re.findall(r"\]\((?:docs/)?images/(.+?)\)", used)} == pictures


def test_a_picture_of_another_behaviour_is_noticed(tmp_path, monkeypatch):
    """The stamp is that of the reference, and a change in it is seen."""
    spec = importlib.util.spec_from_file_location("make_pictures", IMAGES / "make.py")
    make = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(make)
    folder = tmp_path / "handover"
    folder.mkdir()
    whole = (make.REFERENCES / "handover" / "closed_loop.csv").read_text()
    (folder / "closed_loop.csv").write_text(whole.replace("0.1", "0.2", 1))
    monkeypatch.setattr(make, "REFERENCES", tmp_path)
    other = make.stamp("handover", IMAGES / "cell.png")
    assert other["reference_sha256"] != STAMPS["cell.png"]["reference_sha256"]
    assert other["picture_sha256"] == STAMPS["cell.png"]["picture_sha256"]
