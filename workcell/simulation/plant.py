"""The plant: the simulated cell, which knows of the controller only what it is told to do.

    dynamic     MuJoCo steps the scene; the servos follow the controls
    kinematic   every joint does exactly what it was commanded

Each control period the measured state goes to the controller in MuJoCo's control callback, and actuator
controls, joint commands and the state of the hands come back.
"""

from __future__ import annotations

import copy
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.errors import InputError
from workcell.scene.cell import Cell
from workcell.simulation.instruments import Instruments
from workcell.simulation.measurement import Measurement

_callback_in_use = threading.Lock()


class Steersman(Protocol):
    """What the plant needs of a controller."""

    def control(
        self, data: mujoco.MjData, qpos: NDArray[np.float64], qvel: NDArray[np.float64]
    ) -> None:
        """One tick, from the measured state to the controls in `data`."""
        ...

    @property
    def record(self) -> Any:
        """Of the last tick; raises what the tick has raised."""
        ...

    @property
    def holders(self) -> Mapping[str, str | None]:
        """For every instrument the arm whose hand is to be closed on it."""
        ...


class Plant:
    """The simulated cell.

    Args:
        cell: The compiled cell.
    """

    def __init__(self, cell: Cell):
        self._cell = cell
        self._kinematic = cell.scenario.simulation.plant == "kinematic"
        self.model = _without_sensors(cell.model)
        self.data = mujoco.MjData(self.model)
        """The true state."""
        cell.place_home(self.data)
        mujoco.mj_kinematics(cell.model, self.data)
        self.measurement = Measurement(cell.scenario.simulation)
        self._instruments = Instruments(cell, self.data)
        self._state = np.array(self.data.qpos), np.array(self.data.qvel)
        """As it was when the controller was last asked."""

    @contextmanager
    def steered_by(self, controller: Steersman) -> Iterator[None]:
        """Let a controller steer this plant, and remove it whatever happens.

        Raises:
            InputError: another simulation of this process is under way: MuJoCo has one control callback
                a process.
        """
        data, measurement, instruments = self.data, self.measurement, self._instruments

        def callback(called_model: mujoco.MjModel, called_data: mujoco.MjData) -> None:
            # The callback is global to the process: other simulations in it must not be steered.
            if called_data is data:
                self._state = np.array(data.qpos), np.array(data.qvel)
                controller.control(data, *measurement.read(data.qpos, data.qvel))
                instruments.follow(controller.holders, data)

        if not _callback_in_use.acquire(blocking=False):
            raise InputError(_BUSY.format(name=self._cell.scenario.name))
        before = mujoco.get_mjcb_control()
        try:
            mujoco.set_mjcb_control(callback)
            yield
        finally:
            mujoco.set_mjcb_control(before)
            _callback_in_use.release()

    def step(self, controller: Steersman) -> Any:
        """One control period; the callback fires inside.

        Returns:
            The controller's record, with the true state it was made at.
        """
        model, data = self.model, self.data
        self._instruments.carry(data)
        if not self._kinematic:
            mujoco.mj_step(model, data)
            return self._completed(controller.record)
        mujoco.mj_forward(model, data)
        record = controller.record
        data.qvel[:] = record.command_rad_s
        mujoco.mj_integratePos(model, data.qpos, np.asarray(data.qvel), self._cell.period_s)
        data.time += self._cell.period_s
        return self._completed(record)

    def _completed(self, record: Any) -> Any:
        """A record with what only the plant knows."""
        qpos, qvel = self._state
        return record._replace(plant_qpos=qpos, plant_qvel=qvel)


_BUSY = (
    "scenario {name}: another simulation of this process is under way, and MuJoCo has one control callback a process; "
    "run them one after another, or each in a process of its own"
)


def _without_sensors(model: mujoco.MjModel) -> mujoco.MjModel:
    """The same model, which moves the same. Witness points are the controller's to find, on its own data."""
    plant = copy.copy(model)
    plant.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_SENSOR
    return plant
