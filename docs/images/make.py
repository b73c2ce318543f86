"""The pictures of README and docs, made of the reference runs, with a stamp of what they show.

Run by `make pictures`. Every picture comes from a run of a reference scenario
(tests/replay/references). `stamps.json` keeps for each picture its own hash and that of the reference it
agrees with; tests/test_pictures.py compares both with what is there, so that a change of behaviour
cannot leave an old picture behind.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from workcell import run as runner
from workcell.regression import reference as references
from workcell.regression.replay import closed_loop
from workcell.trace.table import Trace
from workcell.view.figures import paper_figures
from workcell.view.film import Clip, film

IMAGES = Path(__file__).parent
REFERENCES = IMAGES.parents[1] / "tests" / "replay" / "references"
STAMPS = IMAGES / "stamps.json"
FILM = {"fps": 10, "height": 300}
"""Chosen for films of less than a megabyte that can still be read."""


def handover(trace: Trace, scene_xml: Path, folder: Path) -> dict[str, Path]:
    """Figures 3, 4 and 5 of the paper, and a film at twice the speed."""
    three, four, five, _ = paper_figures(trace, scene_xml, folder)
    clip = Clip(trace, scene_xml, "handover, twice as fast")
    moving = film([clip], folder / "handover.webp", speed=2.0, **FILM)
    return {"ttc.png": three, "artc.png": four, "cell.png": small(five), "handover.webp": moving}


def busy_human(trace: Trace, scene_xml: Path, folder: Path) -> dict[str, Path]:
    """A film of a delivery beside a person at work, at twice the speed."""
    clip = Clip(trace, scene_xml, "busy_human, twice as fast")
    return {
        "busy_human.webp": film([clip], folder / "busy_human.webp", speed=2.0, end_s=30.0, **FILM)
    }


PICTURES: dict[str, Callable[[Trace, Path, Path], dict[str, Path]]] = {
    "handover": handover,
    "busy_human": busy_human,
}


def small(picture: Path) -> Path:
    """A picture of the cell with colours enough for a page."""
    from PIL import Image

    with Image.open(picture) as whole:
        whole.convert("RGB").quantize(160).save(picture, optimize=True)
    return picture


def main() -> int:
    """Make all pictures; 1 where a run does not agree with its reference, whose pictures would lie."""
    stamps = {}
    for name, draw in PICTURES.items():
        kept = references.load(REFERENCES / name)
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            again = closed_loop(kept.scenario, folder)
            changed = references.metric_changes((again.summary or {})["metrics"], kept.metrics)
            if changed:
                print(f"{name}: {changed[0].name} is {changed[0].now}, not {changed[0].reference}")
                return 1
            scene_xml = folder / runner.SCENE_FOLDER / runner.SCENE_FILE
            for picture, made in draw(again.trace, scene_xml, folder).items():
                shutil.copyfile(made, IMAGES / picture)
                stamps[picture] = stamp(name, IMAGES / picture)
                print(f"{picture}: {made.stat().st_size / 1e3:.0f} kB")
    STAMPS.write_text(json.dumps(stamps, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    return 0


def stamp(scenario: str, picture: Path) -> dict[str, str]:
    """What a picture shows: the scenario, the behaviour its reference keeps, and the picture itself."""
    return {
        "scenario": scenario,
        "reference_sha256": _hash(REFERENCES / scenario / "closed_loop.csv"),
        "picture_sha256": _hash(picture),
    }


def _hash(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


if __name__ == "__main__":
    sys.exit(main())
