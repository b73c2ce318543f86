"""The same inequality, t >= t_min on the same pairs in the same states, done by others.

Two lanes, in turns within one process: rows (distances and their Jacobian), and the whole step.
Agreement is with finite differences, not with each other.
"""

from __future__ import annotations

import copy
from importlib import metadata

import mink
import mujoco
import numpy as np
import pytest

from tests.bench.conftest import Stopwatch
from workcell.control.controller import Controller
from workcell.control.ik import ArmIk, TtcLimit
from workcell.control.proximity import PairGeometry

T_MIN_S = 1.0
EVERYTHING_M = 10.0
"""Detection distance at which no pair of the cell is left out."""
TURNS, CALLS = 10, 30


@pytest.fixture
def mink_limit(cell) -> mink.CollisionAvoidanceLimit:
    """mink's limit on the very pairs that are watched, with the gain that makes it mean t >= t_min.

    It bounds the displacement of a step by gain d/dt; with gain dt²/t_min that is d dt/t_min. The
    list of pairs is set directly, as geoms without contact bits would be left out of it.
    """
    limit = mink.CollisionAvoidanceLimit(
        copy.copy(cell.model),
        [],
        gain=cell.period_s**2 / T_MIN_S,
        minimum_distance_from_collisions=0.0,
        collision_detection_distance=EVERYTHING_M,
    )
    limit.geom_id_pairs = [tuple(map(int, pair)) for pair in cell.pairs.geoms]
    limit.max_num_contacts = len(limit.geom_id_pairs)
    limit._init_broadphase(cell.model)
    return limit


@pytest.fixture
def geometry(cell) -> PairGeometry:
    return PairGeometry(cell.model, [tuple(p) for p in cell.pairs.geoms], cell.sensor_adr)


def _configuration(cell, state) -> mink.Configuration:
    configuration = mink.Configuration(cell.model)
    configuration.data.qvel[:] = state[1]
    configuration.update(state[0])
    return configuration


def _slopes(cell, geometry, qpos) -> np.ndarray:
    """G of all pairs by central differences, (P, nv)."""
    data, step = mujoco.MjData(cell.model), 1e-6

    def distances(q: np.ndarray) -> np.ndarray:
        data.qpos[:] = q
        mujoco.mj_kinematics(cell.model, data)
        mujoco.mj_comPos(cell.model, data)
        mujoco.mj_sensorPos(cell.model, data)
        return geometry.measure(data).distance_m

    moves = step * np.eye(cell.model.nv)
    return np.stack([distances(qpos + m) - distances(qpos - m) for m in moves], axis=1) / (2 * step)


def _in_turns(**functions) -> dict[str, Stopwatch]:
    """Times of several functions, called alternately so that all see the same machine."""
    watches = {name: Stopwatch() for name in functions}
    for _ in range(TURNS):
        for name, function in functions.items():
            for _ in range(CALLS):
                watches[name].time(function)
    return watches


def test_rows(benchmark, cell, states, geometry, mink_limit):
    """Distances and rows of all pairs: ours with MuJoCo's sensors, mink's one pair at a time."""
    state = states[-1]
    configuration = _configuration(cell, state)
    ours = TtcLimit(geometry, t_min_s=T_MIN_S)
    dt = cell.period_s
    watches = _in_turns(
        ours=lambda: ours.compute_qp_inequalities(configuration, dt),
        mink=lambda: mink_limit.compute_qp_inequalities(configuration, dt),
    )
    slopes = _slopes(cell, geometry, state[0])
    apart = geometry.measure(configuration.data).distance_m > 0.0
    errors = {
        name: float(
            np.abs(-limit.compute_qp_inequalities(configuration, dt).G - slopes)[apart].max()
        )
        for name, limit in (("ours", ours), ("mink", mink_limit))
    }
    times = {name: watch.told() for name, watch in watches.items()}
    benchmark.extra_info |= {"times": times, "error_of_rows": errors, "pairs": len(geometry)}
    benchmark(lambda: None)
    print(f"\n{len(geometry)} pairs, rows: {times}; largest error {errors}; {_versions()}")
    assert errors["ours"] < 1e-6
    assert watches["ours"].median_us < watches["mink"].median_us


def test_whole_step(benchmark, cell, states, mink_limit):
    """The controller's tick against mink.solve_ik on both arms, bare and with its collision limit."""
    control, dt = cell.scenario.control, cell.period_s
    configuration = _configuration(cell, states[0])
    arms = [
        ArmIk(
            arm,
            nv=cell.model.nv,
            dt_s=dt,
            task_gain_per_s=control.task_gain_per_s,
            criterion_gain=control.criterion_gain,
        )
        for arm in cell.arms
    ]
    program = {
        "tasks": [task for arm in arms for task in arm.tasks],
        "constraints": [task for arm in arms for task in arm.constraints],
    }
    joints = [arm.limit for arm in arms]
    controller = Controller(cell)
    turn = iter(range(10**9))

    def state():
        return states[next(turn) % len(states)]

    def solve(limits):
        configuration.update(state()[0])
        for arm in arms:
            arm.tool.set_target_from_configuration(configuration)
        return mink.solve_ik(configuration, dt=dt, solver="daqp", limits=limits, **program)

    def tick():
        if controller.tick >= len(states):
            controller.__init__(cell)  # from the start again, as the states are
        controller.step(*states[controller.tick])

    watches = _in_turns(
        tick=tick, mink=lambda: solve(joints), mink_with_pairs=lambda: solve([*joints, mink_limit])
    )
    ratio = {
        name: watches["tick"].median_us / watches[name].median_us
        for name in ("mink", "mink_with_pairs")
    }
    times = {name: watch.told() for name, watch in watches.items()}
    benchmark.extra_info |= {"times": times, "tick_over": ratio}
    benchmark(lambda: None)
    print(f"\nwhole step: {times}; tick over {ratio}; {_versions()}")
    assert ratio["mink_with_pairs"] < 1.0


def _versions() -> str:
    names = ("mujoco", "mink", "daqp", "numpy")
    return ", ".join(f"{name} {metadata.version(name)}" for name in names)
