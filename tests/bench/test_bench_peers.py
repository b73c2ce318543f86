"""The same inequality, t >= t_min on the same pairs in the same states, done by others.

Lanes, in turns within one process: distances, rows (distances and their Jacobian) and the whole
step. Beside mink, which is always there, Pink, Drake and cbfpy take part where they are installed
(tests/bench/peers.py). Rows are judged by finite differences, not by each other; steps by the exact
solution of the program that all are given.
"""

from __future__ import annotations

import copy
import functools
from collections.abc import Callable
from importlib import metadata

import mink
import mujoco
import numpy as np
import pytest

from tests.bench import peers
from tests.bench.conftest import Stopwatch, drive
from workcell.control.controller import Controller
from workcell.control.ik import ArmIk, TtcLimit
from workcell.control.proximity import PairGeometry
from workcell.scene import cell as scene

T_MIN_S = peers.T_MIN_S
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
        collision_detection_distance=peers.EVERYTHING_M,
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


def _in_turns_over(wishes, functions) -> dict[str, Stopwatch]:
    """Likewise with a state as argument, another at every call: Pink keeps what it computed for one."""
    watches: dict[str, Stopwatch] = {name: peers.ProcessStopwatch() for name in functions}
    for turn in range(TURNS):
        for name, function in functions.items():
            for call in range(CALLS):
                watches[name].time(function, wishes[(turn * CALLS + call) % len(wishes)])
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


# ---------------------------------------------------------------- Pink, Drake, cbfpy


@pytest.fixture(scope="session")
def problem(cell, tmp_path_factory) -> peers.Problem:
    folder = tmp_path_factory.mktemp("peers")
    return peers.problem(scene.build(cell.scenario, folder), folder)


@pytest.fixture(scope="session")
def wishes(cell, problem) -> list[peers.Wish]:
    """Three hundred of the first four seconds, in which the nurse passes the surgeon's elbow."""
    return peers.wishes(cell, drive(cell, ticks=2000)[200::6])


@pytest.fixture(scope="session")
def built(problem) -> Callable[[str], peers.Peer]:
    return functools.cache(lambda name: peers.peer(name, problem))


class _Ours:
    """What the peers are held against: our measurement, and mink's `solve_ik` with our limit."""

    def __init__(self, cell, geometry, problem):
        self.cell, self.geometry, self.dt = cell, geometry, cell.period_s
        self.configuration = mink.Configuration(cell.model)
        cost = peers.TOOL_WEIGHT**0.5
        self.tools = [
            mink.FrameTask(name, "body", position_cost=cost, orientation_cost=cost)
            for name in problem.tools
        ]
        speeds = dict(zip(problem.joints, problem.speed_rad_s, strict=True))
        self.speed_limit = mink.VelocityLimit(cell.model, speeds)
        self.limit = TtcLimit(geometry, t_min_s=T_MIN_S)

    def distances(self, wish: peers.Wish) -> np.ndarray:
        """The length of MuJoCo's witness lines; no pair of these states penetrates."""
        data = self.configuration.data
        data.qpos[:] = wish.qpos
        mujoco.mj_kinematics(self.cell.model, data)
        mujoco.mj_sensorPos(self.cell.model, data)
        fromto = data.sensordata.reshape(-1, 6)
        return np.linalg.norm(fromto[:, 3:] - fromto[:, :3], axis=1)

    def rows(self, wish: peers.Wish) -> peers.Rows:
        self.configuration.update(wish.qpos)
        mujoco.mj_sensorPos(self.cell.model, self.configuration.data)
        measured = self.geometry.measure(self.configuration.data)
        return measured.distance_m, measured.jacobian

    def solve(self, wish: peers.Wish, limit: mink.Limit) -> np.ndarray:
        self.configuration.update(wish.qpos)
        for tool, target in zip(self.tools, wish.target, strict=True):
            tool.set_target(mink.SE3.from_matrix(target))
        return mink.solve_ik(
            self.configuration,
            self.tools,
            self.dt,
            solver="daqp",
            damping=1.0,
            limits=[self.speed_limit, limit],
        )

    def step(self, wish: peers.Wish) -> np.ndarray:
        return self.solve(wish, self.limit)


@pytest.fixture
def ours(cell, geometry, problem) -> _Ours:
    return _Ours(cell, geometry, problem)


@pytest.mark.parametrize("name", peers.PEERS)
def test_peer_distances(benchmark, cell, ours, wishes, built, name):
    """Kinematics and the distances of all pairs."""
    peer, configuration = built(name), mink.Configuration(cell.model)

    def mink_does(wish):
        """What its limit asks of MuJoCo."""
        data = configuration.data
        data.qpos[:] = wish.qpos
        mujoco.mj_kinematics(cell.model, data)
        fromto = np.empty(6)
        for g, h in cell.pairs.geoms.tolist():
            mujoco.mj_geomDistance(cell.model, data, g, h, peers.EVERYTHING_M, fromto)

    errors = [np.abs(peer.distances(w.qpos) - ours.distances(w)).max() for w in wishes[::10]]
    watches = _in_turns_over(
        wishes, {"ours": ours.distances, "mink": mink_does, name: lambda w: peer.distances(w.qpos)}
    )
    error_m = float(max(errors))
    _tell(benchmark, name, "distances", watches, error_mm=1e3 * error_m)
    assert error_m < peers.PEERS[name].distance_m


@pytest.mark.parametrize("name", peers.PEERS)
def test_peer_rows(benchmark, cell, ours, wishes, geometry, mink_limit, built, name):
    """Kinematics, distances and Jacobian of all pairs; the error is against central differences."""
    peer = built(name)

    def mink_rows(wish):
        ours.configuration.update(wish.qpos)
        return mink_limit.compute_qp_inequalities(ours.configuration, ours.dt)

    errors = dict.fromkeys(("ours", "mink", name), 0.0)
    for wish in wishes[::30]:
        slopes = _slopes(cell, geometry, wish.qpos)
        found = {
            "ours": ours.rows(wish)[1],
            "mink": -mink_rows(wish).G,
            name: peer.rows(wish.qpos)[1],
        }
        for who, rows in found.items():
            errors[who] = max(errors[who], float(np.abs(rows - slopes).max()))
    watches = _in_turns_over(
        wishes, {"ours": ours.rows, "mink": mink_rows, name: lambda w: peer.rows(w.qpos)}
    )
    _tell(benchmark, name, "rows", watches, error_m_per_rad=errors)
    assert errors["ours"] < 1e-6
    assert errors[name] < peers.PEERS[name].row_m_per_rad


@pytest.mark.parametrize("name", peers.PEERS)
def test_peer_step(benchmark, cell, states, ours, wishes, problem, mink_limit, built, name):
    """Joint velocities of both arms for the same program; the tick, which does more, beside them."""
    peer, controller = built(name), Controller(cell)

    def tick(_):
        if controller.tick >= len(states):
            controller.__init__(cell)  # from the start again, as the states are
        controller.step(*states[controller.tick])

    steps = {
        "ours": ours.step,
        "mink": lambda wish: ours.solve(wish, mink_limit),
        name: peer.step,
    }
    off, kept, binding = dict.fromkeys(steps, 0.0), dict.fromkeys(steps, np.inf), 0
    for wish in wishes:
        distance, rows = ours.rows(wish)
        jacobian = peers.tool_jacobian(cell, ours.configuration.data)
        best = peers.exact(problem, wish, jacobian, (distance, rows))
        binding += bool((distance + T_MIN_S * rows @ best).min() < 1e-9)
        for who, step in steps.items():
            velocity = step(wish)
            off[who] = max(off[who], float(np.abs(velocity - best).max()))
            kept[who] = min(kept[who], float((distance + T_MIN_S * rows @ velocity).min()))
    watches = _in_turns_over(wishes, {"tick": tick, **steps})
    _tell(
        benchmark,
        name,
        "step",
        watches,
        off_rad_s=off,
        least_d_plus_rate_t_min_mm={who: 1e3 * value for who, value in kept.items()},
        states_where_a_pair_binds=binding / len(wishes),
    )
    assert binding  # or the inequality would not have been seen to bite
    assert kept[name] > -peers.PEERS[name].undercut_m


def _tell(benchmark, name, lane, watches, **figures) -> None:
    """Print and store times, as ratios to the peer's own, and how far the answers agree."""
    times = {who: watch.told() for who, watch in watches.items()}
    ratio = {
        f"{name}_over_{who}": round(watches[name].median_us / watch.median_us, 3)
        for who, watch in watches.items()
        if who != name
    }
    told = {"times": times, "ratio": ratio, "versions": _versions(name), **figures}
    benchmark.extra_info |= told
    benchmark.pedantic(lambda: None)
    medians = {who: watch["cpu_median_us"] for who, watch in times.items()}
    print(f"\n{name}, {lane}: {medians} us; {ratio}; {figures}; {told['versions']}")


def _versions(peer: str | None = None) -> str:
    names = ("mujoco", "mink", "daqp", "numpy", *(peers.PEERS[peer].versions if peer else ()))
    return ", ".join(f"{name} {metadata.version(name)}" for name in names)
