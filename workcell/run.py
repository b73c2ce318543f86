"""One scenario -> one trace: the spine of the package, to be read first.

    prepare   scenario -> cell (compiled scene, watched pairs, arms), refused if it cannot be run
    simulate  cell -> trace, tick by tick, with the controller installed as MuJoCo's control callback
    conclude  trace -> summary (metrics, expectations with verdicts) and recording

Nothing in the loop reads a clock: time is tick × period, so the same scenario, seed and versions
give the same trace.
"""

from __future__ import annotations

import copy
import json
import platform
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from workcell import __version__
from workcell.control import feasible
from workcell.control.controller import Controller
from workcell.control.kernels import library
from workcell.errors import ControlFault, InputError
from workcell.guard.check_setup import check_settings, refusal, without_geometry
from workcell.guard.monitor import FinalCheck
from workcell.guard.supervisor import LatchedCheck
from workcell.scenario import Exchange, Fetch, Live, Meet, Put, Scenario
from workcell.scene import cell as scene
from workcell.scene.cell import Cell
from workcell.scene.compose import SCENE_FILE
from workcell.scene.contacts import hand_bodies
from workcell.signals import Layout
from workcell.simulation.measurement import Measurement
from workcell.trace import metrics
from workcell.trace.expectations import judge
from workcell.trace.preflight import check_space, check_writable
from workcell.trace.table import Trace, load
from workcell.trace.writer import FLUSH_S, TraceWriter

SCENARIO_FILE = "scenario.toml"
SUMMARY_FILE = "summary.json"
ORIGIN_FILE = "origin.json"
RECORDING_FILE = "recording.rrd"
SCENE_FOLDER = "scene"
CHECK_STOP = "stopped_by_check"
"""Metric: whether the final check has stopped the arms. A run in which it has is not held, unless `[expect]` says so."""

PACKAGES = (
    "mujoco",
    "dm-control",
    "mink",
    "daqp",
    "rerun-sdk",
    "numpy",
    "scipy",
    "pyarrow",
)
"""Packages whose versions decide what a trace holds."""


@dataclass(frozen=True)
class Ending:
    """How a simulation ended."""

    ticks: int
    """Ticks done."""
    fault: str | None
    """What stopped it before its time, None if it ran to its end."""
    interrupted: bool
    """Whether a person stopped it."""
    check: dict | None
    """What the final check has to say of itself and of a halt; None if it was off."""


def run(
    scenario: Scenario, out: Path, *, progress: Callable[[int, int], None] | None = None
) -> dict:
    """Run a scenario into a run folder.

    Args:
        scenario: What to run.
        out: Run folder; made if missing, its earlier contents replaced file by file.
        progress: Called with (ticks done, ticks of a full run) now and then.

    Returns:
        The summary, as written to summary.json.

    Raises:
        InputError: the scenario cannot be run as it is.
    """
    _refuse_live(scenario)
    check_writable(out)
    cell = prepare(scenario, out / SCENE_FOLDER)
    check_space(out, layout(cell), scenario.ticks)
    (out / SCENARIO_FILE).write_text(scenario.to_toml(), encoding="utf-8")
    (out / ORIGIN_FILE).write_text(json.dumps(origin(cell), indent=2) + "\n", encoding="utf-8")
    ending = simulate(cell, out, progress=progress)
    return conclude(cell, out, ending)


def _refuse_live(scenario: Scenario) -> None:
    """Nobody sits at the other end of a headless run."""
    faults = [
        f"arm.{arm.name}.operator.kind = 'live': needs a person; use `workcell teleop`, or give a recording with --set arm.{arm.name}.operator.file=FILE"
        for arm in scenario.arm
        if isinstance(arm.operator, Live)
    ]
    if faults:
        raise InputError(faults, file=scenario.file)


def prepare(scenario: Scenario, folder: Path) -> Cell:
    """Compose the scene into `folder`, compile it and refuse what cannot be run."""
    cell = scene.build(scenario, folder)
    scene.check_start(cell)
    feasible.check(cell)
    return cell


def simulate(
    cell: Cell,
    out: Path,
    *,
    progress: Callable[[int, int], None] | None = None,
    watch: Callable[[int, mujoco.MjData, Controller], bool | None] | None = None,
    flush_s: float = FLUSH_S,
    check: LatchedCheck | None = None,
) -> Ending:
    """Step the plant with the controller in its callback; every tick becomes a row of the trace.

    Args:
        cell: What is simulated.
        out: Run folder that holds the scene; the trace is written into it.
        progress: Called with (ticks done, ticks of a full run) now and then.
        watch: Called before every tick with its number, the plant's true state, which it may not
            change, and the controller, to which it may offer samples and changes; True ends the run.
        flush_s: Simulated time of trace that a kill may cost.
        check: A final check that is running already; None starts one in lock-step if the scenario
            wants it.
    """
    scenario = cell.scenario
    plant = _without_sensors(cell.model)
    data = mujoco.MjData(plant)
    cell.place_home(data)
    step = _step_kinematic if scenario.simulation.plant == "kinematic" else _step_dynamic
    fault, interrupted = None, False
    with ExitStack() as stack:
        if check is None:
            check = stack.enter_context(final_check(cell, out))
        controller = Controller(cell, check=check)
        trace = stack.enter_context(
            TraceWriter(out, layout(cell), metadata(cell), cell.period_s, flush_s=flush_s)
        )
        measurement = Measurement(scenario.simulation)
        stack.enter_context(installed(controller, measurement, data))
        try:
            for tick in range(scenario.ticks):
                if watch and watch(tick, data, controller):
                    break
                step(cell, plant, controller, data)
                trace.append(controller.record)
                if progress and tick % 250 == 0:
                    progress(tick, scenario.ticks)
        except ControlFault as error:
            fault = str(error)
        except KeyboardInterrupt:
            interrupted = True
    if progress:
        progress(scenario.ticks, scenario.ticks)
    return Ending(controller.tick, fault, interrupted, None if check is None else check.account())


@contextmanager
def final_check(cell: Cell, out: Path, *, live: bool = False) -> Iterator[LatchedCheck | None]:
    """Start the final check in its own process, unless the scenario switches it off.

    Args:
        cell: What is simulated.
        out: Run folder that holds the scene.
        live: Whether time goes on while the checker works; see `LatchedCheck`.

    Raises:
        InputError: an arm has no geometry the check could judge.
    """
    settings = cell.scenario.check
    if not settings.enabled:
        yield None
        return
    with FinalCheck(out / SCENE_FOLDER / SCENE_FILE, check_settings(cell)) as check:
        try:
            verdict = check.start()
        except InputError as error:
            raise refusal(cell, error.faults) from error
        if check.missing:
            raise refusal(cell, [without_geometry(check.missing)])
        if verdict.must_stop:
            raise refusal(cell, [f"{verdict.state}: {verdict.reason}"])
        yield LatchedCheck(check, period_s=cell.period_s, live=live)


def conclude(cell: Cell, out: Path, ending: Ending) -> dict:
    """Judge the trace, write the summary and derive the recording."""
    # rerun takes half a second to import, which `check` need not wait for
    from workcell.view import recording as view

    trace = load(out)
    summary = summarise(cell, trace, ending)
    (out / SUMMARY_FILE).write_text(
        json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8"
    )
    view.record(trace, out / SCENE_FOLDER / SCENE_FILE, out / RECORDING_FILE)
    return summary


def rebuild_recording(out: Path) -> Path:
    """The recording of a run folder, derived anew where it is missing or from another rerun version."""
    from workcell.view import recording as view

    recording, trace = out / RECORDING_FILE, load(out)
    if not recording.is_file() or not view.is_current(recording, trace):
        view.record(trace, out / SCENE_FOLDER / SCENE_FILE, recording)
    return recording


def summarise(cell: Cell, trace: Trace, ending: Ending) -> dict:
    """Metrics of a run, the verdict on each expectation, and where it all came from."""
    stop = _stop_of_check(ending)
    values = metrics.summarise(trace) | {
        "fault": ending.fault,
        "interrupted": ending.interrupted,
        CHECK_STOP: stop,
    }
    verdicts = judge(values, cell.scenario.expect)
    held = (
        ending.fault is None
        and not ending.interrupted
        # A stop that the scenario expects is judged like any expectation.
        and (stop in ("off", "none") or CHECK_STOP in verdicts)
        and all(v["held"] for v in verdicts.values())
    )
    return {
        "scenario": cell.scenario.name,
        "scenario_sha256": cell.scenario.digest(),
        "held": held,
        "expectations": verdicts,
        "metrics": values,
        "final_check": ending.check or {"state": "off"},
        "watched_pairs": len(cell.pairs),
        "omitted_pairs": [list(pair) for pair in cell.pairs.omitted],
        "notes": list(cell.notes),
        "versions": versions(),
    }


def _stop_of_check(ending: Ending) -> str:
    """`off`, `none`, or the state in which the final check stopped the arms (docs/final_check.md)."""
    if ending.check is None:
        return "off"
    halt = ending.check["halt"]
    return "none" if halt is None else str(halt["state"])


def layout(cell: Cell) -> Layout:
    """What fixes the width of the trace's columns."""
    return Layout(
        arms=tuple(arm.name for arm in cell.arms),
        joints=tuple(cell.model.joint(j).name for j in range(cell.model.njnt)),
        nq=cell.model.nq,
        nv=cell.model.nv,
        pairs=cell.pairs.names,
    )


def metadata(cell: Cell) -> dict[str, str]:
    """Where a trace comes from: stored with it, apart from the data."""
    return {
        "scenario": cell.scenario.digest(),
        "settings": cell.scenario.model_dump_json(),
        "versions": json.dumps(versions()),
        "platform": _platform(),
        "seed": str(cell.scenario.simulation.seed),
        "model_sha256": cell.digest,
        "meeting_pairs": json.dumps(meeting_pairs(cell)),
        "hands": json.dumps(hands(cell)),
        "person_pairs": json.dumps(person_pairs(cell)),
        "dofs": json.dumps({arm.name: arm.dofs.tolist() for arm in cell.arms}),
    }


def origin(cell: Cell) -> dict[str, Any]:
    """When and where a run began: apart from the trace, so that equal runs have equal traces."""
    return {
        "started_utc": datetime.now(UTC).isoformat(timespec="seconds"),
        "platform": _platform(),
        "versions": versions(),
        "scenario_sha256": cell.scenario.digest(),
        "model_sha256": cell.digest,
        "seed": cell.scenario.simulation.seed,
    }


def _platform() -> str:
    return f"{platform.system()} {platform.machine()} Python {platform.python_version()}"


def person_pairs(cell: Cell) -> list[int]:
    """Pairs that only people answer for: arms they drive, with themselves, each other or what stands."""
    driven = {arm.name for arm in cell.scenario.arm if arm.operator is not None}
    return [
        k
        for k, owners in enumerate(cell.pairs.owners)
        if all(owner is None or owner in driven for owner in owners)
    ]


def hands(cell: Cell) -> dict[str, list[int]]:
    """Watched pairs of an instrument with an arm's own hand, by `instrument=arm`: they do not count while it holds it."""
    bodies = {arm.name: hand_bodies(cell.model, arm) for arm in cell.arms}
    found: dict[str, list[int]] = {}
    for k, (geoms, owners) in enumerate(zip(cell.pairs.geoms, cell.pairs.owners, strict=True)):
        item, arm = owners
        if arm in bodies and item not in bodies and cell.model.geom_bodyid[geoms[1]] in bodies[arm]:
            found.setdefault(f"{item}={arm}", []).append(k)
    return found


def meeting_pairs(cell: Cell) -> list[tuple[str, str]]:
    """Watched pairs that a job brings together on purpose: tools that meet, and instruments with the hands they pass through."""
    tools = {arm.name: cell.model.site_bodyid[arm.tool_site] for arm in cell.arms}
    meetings: list[set[str]] = []
    for arm in cell.scenario.arm:
        for job in arm.job:
            if isinstance(job, Meet):
                meetings.append({arm.name, job.arm})
            elif isinstance(job, Exchange):
                meetings += [{arm.name, job.instrument}, {job.arm, job.instrument}]
            elif isinstance(job, (Fetch, Put)):
                meetings.append({arm.name, job.instrument})
    return [
        names
        for (g, h), names, owners in zip(
            cell.pairs.geoms, cell.pairs.names, cell.pairs.owners, strict=True
        )
        if set(owners) in meetings
        and all(
            o not in tools or cell.model.geom_bodyid[x] == tools[o]
            for x, o in zip((g, h), owners, strict=True)
        )
    ]


def versions() -> dict[str, str]:
    """Versions of everything that decides what a trace holds, and which arithmetic is used (docs/performance.md)."""
    packages = {name: version(name) for name in PACKAGES}
    return {"workcell": __version__} | packages | {"kernels": library.in_use()}


@contextmanager
def installed(
    controller: Controller, measurement: Measurement, data: mujoco.MjData
) -> Iterator[None]:
    """Install the controller as MuJoCo's control callback for one plant, and remove it whatever happens."""

    def callback(called_model: mujoco.MjModel, called_data: mujoco.MjData) -> None:
        # The callback is global to the process: other simulations in it must not be steered.
        if called_data is data:
            controller.control(data, *measurement.read(data.qpos, data.qvel))

    mujoco.set_mjcb_control(callback)
    try:
        yield
    finally:
        mujoco.set_mjcb_control(None)


def _without_sensors(model: mujoco.MjModel) -> mujoco.MjModel:
    """The plant: the same model, which moves the same. Witness points are the controller's to find, on its own data."""
    plant = copy.copy(model)
    plant.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_SENSOR
    return plant


def _step_dynamic(
    cell: Cell, plant: mujoco.MjModel, controller: Controller, data: mujoco.MjData
) -> None:
    """One control period of MuJoCo's dynamics; the callback fires inside."""
    _carry(cell, controller, data)
    mujoco.mj_step(plant, data)


def _step_kinematic(
    cell: Cell, plant: mujoco.MjModel, controller: Controller, data: mujoco.MjData
) -> None:
    """One control period in which every joint does exactly what it was commanded."""
    _carry(cell, controller, data)
    mujoco.mj_forward(plant, data)
    data.qvel[:] = controller.record.command_rad_s
    mujoco.mj_integratePos(plant, data.qpos, np.asarray(data.qvel), cell.period_s)
    data.time += cell.period_s


def _carry(cell: Cell, controller: Controller, data: mujoco.MjData) -> None:
    """Held instruments are where their tools are; their weight is too small to be felt by an arm."""
    if cell.instruments:
        mujoco.mj_kinematics(cell.model, data)
        mujoco.mj_comPos(cell.model, data)
        controller.grasps.carry(data)
