"""A live operator fed by a device that somebody else brings: a tracker, a haptic handle, a glove.

The device is a class found by name (`workcell.plugins`). It is made once with a `DeviceSetup` and asked
once a tick for the samples that have come since; it must answer at once, from what a thread of its
own has collected. Its samples go through the filter and the governor of every live stream.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from workcell import plugins, scenario
from workcell.errors import ControlFault
from workcell.motion.operators.live import LiveOperator
from workcell.motion.operators.samples import Sample
from workcell.motion.setpoint import Setpoint


@dataclass(frozen=True)
class DeviceSetup:
    """What a device is told once, before the run."""

    arm: str
    """Name of the arm that it drives."""
    position_m: NDArray[np.float64]
    """(3,) of the tool at the start, in the world: where its samples are to begin."""
    wxyz: NDArray[np.float64]
    """(4,) unit quaternion of the tool at the start."""
    options: Any
    """An instance of the class's own `Options`; None if it has none."""


class Device(Protocol):
    """What a device answers."""

    def samples(self, now_s: float) -> Sequence[Sample]:
        """Samples that have come since the last call, stamped on the clock of the run, whose time is now."""
        ...


class DeviceOperator:
    """Follows a device.

    Args:
        settings: From the scenario, with a device.
        position_m, wxyz: Tool pose at the start.
        arm: Name of the arm.
        period_s: Control period.

    Raises:
        InputError: the device cannot be made.
    """

    def __init__(
        self,
        settings: scenario.Live,
        position_m: NDArray[np.float64],
        wxyz: NDArray[np.float64],
        *,
        arm: str,
        period_s: float,
    ):
        self._name, self._period_s = str(settings.device), period_s
        self._live = LiveOperator(settings, position_m, wxyz, period_s=period_s)
        self._device: Device = plugins.make(
            "devices",
            self._name,
            lambda options: DeviceSetup(
                arm=arm,
                position_m=np.array(position_m, dtype=float),
                wxyz=np.array(wxyz, dtype=float),
                options=options,
            ),
            settings.device_options,
        )

    def setpoint(self, time_s: float) -> Setpoint:
        """See `workcell.motion.setpoint.Operator`.

        Raises:
            ControlFault: the device raised, or answered with nonsense.
        """
        try:
            for sample in self._device.samples(time_s):
                self._live.offer(_sound(sample))
        except Exception as error:
            raise ControlFault(
                round(time_s / self._period_s),
                f"device {self._name!r} raised {type(error).__name__}: {str(error)[:500]}",
            ) from error
        return self._live.setpoint(time_s)


def _sound(sample: object) -> Sample:
    """A sample whose arrays have the right shapes; what is wrong with its numbers the filter says.

    Raises:
        TypeError: it is something else.
    """
    if not isinstance(sample, Sample):
        raise TypeError(f"a Sample is needed, it gave {type(sample).__name__}")
    position, wxyz = np.asarray(sample.position_m, float), np.asarray(sample.wxyz, float)
    if position.shape != (3,) or wxyz.shape != (4,):
        raise TypeError(
            f"shapes (3,) and (4,) are needed, it gave {position.shape} and {wxyz.shape}"
        )
    return Sample(float(sample.stamp_s), position, wxyz)
