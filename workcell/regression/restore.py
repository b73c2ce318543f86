"""A whole run folder of what a damaged one still holds, for `replay`, `plot` and `compare`.

In comes a run folder; out comes another with the intact rows of its trace, the resolved scenario that
the trace carries, the scene (copied, or composed anew where the copy is damaged), a recording derived
from the rows, and a summary that says it is a salvaged run's and never held.
"""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco

from workcell import run as runner
from workcell.errors import InputError, TraceError
from workcell.files import read_object, require_files
from workcell.regression.replay import scenario_of
from workcell.scene import cell as scene
from workcell.trace import metrics
from workcell.trace.expectations import judge
from workcell.trace.salvage import Salvage, salvage
from workcell.trace.table import Trace, load
from workcell.view import recording as view


def restore(run: Path, out: Path) -> Salvage:
    """Save what is intact of a run folder and make a run folder of it.

    Args:
        run: The damaged run folder; it is only read.
        out: Folder for the new one; another one than `run`.

    Returns:
        What could be saved. Without a single row there is no run folder, only the recording's rest.

    Raises:
        TraceError: There is neither trace nor recording, or `out` is `run`.
    """
    saved = salvage(run, out, recording_name=runner.RECORDING_FILE)
    if saved.trace is None:
        return saved
    trace, losses = load(saved.trace), list(saved.losses)
    scenario = None
    try:
        scenario = scenario_of(trace)
        (out / runner.SCENARIO_FILE).write_text(scenario.to_toml(), encoding="utf-8")
    except TraceError as error:
        losses.append(str(error))
    _copy_json(run / runner.ORIGIN_FILE, out / runner.ORIGIN_FILE)
    scene_xml = _scene(run, out, trace, losses)
    summary = _summary(trace, scenario, losses)
    recording = saved.recording
    if scene_xml is not None:
        # What is derived from checked rows is better than what the viewer's tool could repair.
        recording = view.record(trace, scene_xml, out / runner.RECORDING_FILE, summary=summary)
    text = json.dumps(summary, indent=2, allow_nan=False) + "\n"
    (out / runner.SUMMARY_FILE).write_text(text, encoding="utf-8")
    return replace(saved, recording=recording, losses=tuple(losses))


def _copy_json(source: Path, target: Path) -> None:
    """Take over a file that is still what it should be; one that is not is left behind."""
    try:
        read_object(source)
    except (OSError, ValueError):
        return
    shutil.copyfile(source, target)


def _scene(run: Path, out: Path, trace: Trace, losses: list[str]) -> Path | None:
    """The scene of the run in the new folder; None where it is damaged and cannot be composed."""
    folder = out / runner.SCENE_FOLDER
    scene_xml = folder / runner.SCENE_FILE
    try:
        shutil.rmtree(folder, ignore_errors=True)
        require_files(run / runner.SCENE_FOLDER)
        shutil.copytree(run / runner.SCENE_FOLDER, folder)
        if mujoco.MjModel.from_xml_path(str(scene_xml)).nq == trace.layout.nq:
            return scene_xml
        fault = f"has not the {trace.layout.nq} coordinates of the trace"
    except (OSError, ValueError) as error:
        fault = str(error).strip().splitlines()[0]
    losses.append(f"{run / runner.SCENE_FOLDER}: {fault}")
    try:
        shutil.rmtree(folder, ignore_errors=True)
        cell = scene.build(scenario_of(trace), folder)
    except (InputError, TraceError, OSError, ValueError) as error:
        losses.append(f"the scene cannot be composed anew: {error}")
        return None
    if cell.digest != trace.metadata.get("model_sha256"):
        losses.append("the scene is composed anew, and is not the run's to the last digit")
    return scene_xml


def _summary(trace: Trace, scenario: Any, losses: list[str]) -> dict[str, Any]:
    """Metrics of the rows that are left; `held` is false, for nobody saw the rest."""
    fault = f"salvaged: {len(trace)} rows are left of a damaged run"
    values = metrics.summarise(trace) | {"fault": fault, "interrupted": True}
    return {
        "scenario": trace.metadata.get("settings", {}).get("name"),
        "scenario_sha256": trace.metadata.get("scenario"),
        "held": False,
        "expectations": {} if scenario is None else judge(values, scenario.expect),
        "metrics": values,
        "final_check": {"state": "unknown"},
        "watched_pairs": len(trace.layout.pairs),
        "versions": trace.metadata.get("versions", {}),
        "salvaged": {"rows": len(trace), "losses": losses},
    }
