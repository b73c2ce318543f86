"""The cell: a scenario made concrete, compiled and checked, before time starts."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from workcell.errors import InputError
from workcell.scenario import Scenario
from workcell.scene import compose, fidelity
from workcell.scene.addresses import (
    ArmAddresses,
    InstrumentAddresses,
    arm_addresses,
    instrument_addresses,
)
from workcell.scene.hand import ahead_m
from workcell.scene.pairs import SENSOR_CUTOFF_M, WatchedPairs, watched_pairs

HELD_GAP_M = 0.02
"""From the tool point to where an instrument held from the start begins, at least; chosen so that a PA10's hand and an
instrument are no nearer than the default d_min, as after a hand-over, and can part again."""


@dataclass(frozen=True)
class Cell:
    """A compiled scene with its addresses; the model is not changed after this."""

    scenario: Scenario
    model: mujoco.MjModel
    arms: tuple[ArmAddresses, ...]
    """In the order of the scenario file."""
    instruments: tuple[InstrumentAddresses, ...]
    """In the order of the scenario file."""
    pairs: WatchedPairs
    sensor_adr: np.ndarray
    """(P,) address of each pair's `fromto` sensor in sensordata."""
    digest: str
    """SHA-256 of scene.xml."""
    notes: tuple[str, ...] = ()
    """What of the arm files was not taken into the cell, what is held, bare or assumed, a sentence each."""

    @property
    def period_s(self) -> float:
        """Length of a control tick."""
        return self.scenario.simulation.period_s

    def place_home(self, data: mujoco.MjData) -> None:
        """Put every arm into its home configuration, at rest."""
        mujoco.mj_resetData(self.model, data)
        for arm in self.arms:
            data.qpos[arm.qpos] = arm.home_rad
        mujoco.mj_kinematics(self.model, data)
        for item in self.instruments:
            holder = next((arm for arm in self.arms if arm.name == item.held_by), None)
            if holder is not None:
                self._put_into_hand(data, item, holder)

    def _put_into_hand(
        self, data: mujoco.MjData, item: InstrumentAddresses, holder: ArmAddresses
    ) -> None:
        """In line with the tool, its near end HELD_GAP_M before the tool point, and d_min before what reaches beyond that."""
        clear_m = self.scenario.control.d_min_m + ahead_m(self.model, data, holder)
        rotation = data.site_xmat[holder.tool_site].reshape(3, 3)
        centre = (
            data.site_xpos[holder.tool_site]
            + (max(HELD_GAP_M, clear_m) + item.radius_m + item.half_length_m) * rotation[:, 2]
        )
        data.qpos[item.qpos : item.qpos + 3] = centre
        mujoco.mju_mat2Quat(
            data.qpos[item.qpos + 3 : item.qpos + 7], data.site_xmat[holder.tool_site]
        )


UNGATED = "control.gate = false: commands of support arms reach the servos UNVERIFIED; only the final check stands behind them"
"""Note of a run without the gate."""


def build(scenario: Scenario, folder: Path) -> Cell:
    """Compose, decide the watched pairs, write scene.xml with their sensors and compile it.

    Raises:
        InputError: an arm cannot be composed or driven.
    """
    composed = compose.compose(scenario)
    bare = compose.preview(composed)
    # Sensors come last and change no number, so that what was resolved without them holds.
    for part in composed.arms:
        fidelity.compare(bare, part.name, part.file, part.form, part.home)
    arms = arm_addresses(bare, scenario, composed.arms)
    instruments = instrument_addresses(bare, scenario)
    try:
        pairs = watched_pairs(
            bare, arms, instruments, arms_digest=composed.arms_digest, ignore=scenario.ignore
        )
    except InputError as error:
        raise InputError(error.faults, file=scenario.file) from error
    compose.add_sensors(composed, pairs.names, SENSOR_CUTOFF_M)
    model = compose.export(composed, folder)
    return Cell(
        scenario=scenario,
        model=model,
        arms=arms,
        instruments=instruments,
        pairs=pairs,
        sensor_adr=np.array(
            [model.sensor(f"pair_{k}").adr[0] for k in range(len(pairs))], dtype=np.intp
        ),
        digest=hashlib.sha256((folder / compose.SCENE_FILE).read_bytes()).hexdigest(),
        notes=(
            *(note for part in composed.arms for note in part.notes),
            *(note for arm in arms for note in arm.assumed),
            *([] if scenario.control.gate else [UNGATED]),
            *(f"NOT held apart: {g} and {h} ({why})" for g, h, why in pairs.ignored),
        ),
    )


def check_start(cell: Cell) -> None:
    """Refuse a start in which a watched pair is nearer than d_min.

    Raises:
        InputError: naming every such pair with its distance.
    """
    data = mujoco.MjData(cell.model)
    cell.place_home(data)
    mujoco.mj_kinematics(cell.model, data)
    d_min = cell.scenario.control.d_min_m
    faults = []
    held = {(item.name, item.held_by) for item in cell.instruments}
    for (g, h), names, owners in zip(
        cell.pairs.geoms, cell.pairs.names, cell.pairs.owners, strict=True
    ):
        if owners in held:
            continue
        distance = mujoco.mj_geomDistance(cell.model, data, g, h, SENSOR_CUTOFF_M, None)
        if distance <= d_min:
            faults.append(
                f"arm.home_rad: start in collision: {names[0]} and {names[1]} are {distance:.4f} m apart; allowed is more than d_min_m = {d_min:g}"
            )
    if faults:
        raise InputError(faults, file=cell.scenario.file)
