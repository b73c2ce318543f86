"""Sensing stage: a measured state -> the controller's belief, the watched pairs and their rates.

The belief is the controller's own copy of the scene. It shares nothing with the plant: only the measured
positions and velocities come in.
"""

from __future__ import annotations

import math

import mink
import mujoco
import numpy as np
from numpy.typing import NDArray

from workcell.control.arm import ControlledArm
from workcell.control.delay import Delay
from workcell.control.finite import require_finite
from workcell.control.grasp import Grasps
from workcell.control.proximity import PairGeometry, Proximity
from workcell.control.second_order import second_order
from workcell.control.tick import ArmSensed, Sensed
from workcell.control.watched import Watched
from workcell.scenario import Control
from workcell.scene.cell import Cell


class Sensing:
    """The belief of one controller, and what it says of the watched pairs.

    Args:
        cell: The compiled cell.
    """

    def __init__(self, cell: Cell):
        self._model = cell.model
        self._period_s = cell.period_s
        self.belief = mink.Configuration(cell.model)
        cell.place_home(self.belief.data)
        self.belief.update()
        data = self.belief.data
        # MuJoCo's arrays never move; asking for them anew each tick takes as long as using them.
        self._site_xmat, self._qpos, self._qvel = data.site_xmat, data.qpos, data.qvel
        self._frames = data.site_xpos, data.cvel, data.subtree_com
        self._delay = Delay(cell)
        self._still = np.zeros(cell.model.nv)
        self._geometry = PairGeometry(
            cell.model, [tuple(pair) for pair in cell.pairs.geoms], cell.sensor_adr
        )
        self.proximity: Proximity
        """Of the watched pairs, in arrays that the next tick overwrites."""
        self.grasps = Grasps(cell)
        self.watched = Watched(len(cell.pairs), [arm.dofs for arm in cell.arms], cell.model.nv)

    def measure(
        self,
        tick: int,
        qpos: NDArray[np.float64],
        qvel: NDArray[np.float64],
        last_rad_s: NDArray[np.float64],
        settings: Control,
    ) -> Sensed:
        """Take a measured state.

        Args:
            tick: Number of the tick.
            qpos, qvel: (nq,) and (nv,) as measured; they are kept.
            last_rad_s: (nv,) the commands of the tick before.
            settings: The parameters in force.

        Raises:
            ControlFault: a number is not finite.
        """
        require_finite(tick, qpos, "qpos, the measured joint positions")
        require_finite(tick, qvel, "qvel, the measured joint velocities")
        told_qpos, told_qvel = qpos, qvel
        qpos, qvel = self._delay.now(qpos, qvel, last_rad_s)
        belief, watched = self.belief, self.watched
        self._qpos[:], self._qvel[:] = qpos, qvel
        belief.update()
        mujoco.mj_comVel(self._model, belief.data)
        mujoco.mj_sensorPos(self._model, belief.data)
        proximity = self.proximity = self._geometry.measure(belief.data, kept=True)
        watched.take(proximity, self.grasps.fold(belief.data, proximity.jacobian))
        watched.accel_m_s2 = None
        if settings.order == 2:
            # Joint accelerations count as zero: nobody knows what a person will do.
            watched.accel_m_s2 = second_order(
                self._geometry, belief.data, proximity, self._still
            ).accel_m_s2
        rates = watched.rates(qvel, watched.accel_m_s2)
        watched.rate_m_s[...] = rates.rate_m_s
        first = rates.first
        shown = first.pair if first.pair >= 0 else rates.nearest
        return Sensed(
            tick=tick,
            time_s=tick * self._period_s,
            qpos=qpos,
            qvel=qvel,
            told_qpos=told_qpos,
            told_qvel=told_qvel,
            settings=settings,
            distance_m=watched.distance_m.copy(),
            rate_m_s=rates.rate_m_s,
            nearest_pair=rates.nearest,
            ttc_s=first.ttc_s if math.isfinite(first.ttc_s) else None,
            ttc_pair=None if first.pair < 0 else first.pair,
            witness_i_m=None if shown is None else proximity.surface_i_m[shown].copy(),
            witness_j_m=None if shown is None else proximity.surface_j_m[shown].copy(),
        )

    def look_at(self, arm: ControlledArm, settings: Control) -> ArmSensed:
        """Where an arm's tool is, and how near its surroundings are on average."""
        wxyz, position = np.empty(4), np.empty(3)
        elbow = None if arm.addresses.elbow_site is None else np.empty(3)
        mujoco.mju_mat2Quat(wxyz, self._site_xmat[arm.addresses.tool_site])
        speed_m_s, artc, armd = arm.constraints.arm_state(
            self._frames,
            position,
            position if elbow is None else elbow,
            approaching=arm.criterion.counts_approaching(settings),
        )
        return ArmSensed(position, wxyz, speed_m_s, elbow, artc, armd)
