"""The simulated robot by its own clock: it follows, its watchdog brakes it, its network is as bad as asked for."""

from __future__ import annotations

import numpy as np
import pytest

from workcell.robot import wire
from workcell.robot.simulated import RobotSettings, _Joints, _Network, stood_after_s

SETTINGS = RobotSettings((0.0,), (10.0,), watchdog_s=0.05)


def command(number: int, velocity: float = 0.5, *, stop: bool = False) -> wire.CommandDatagram:
    return wire.CommandDatagram(number, stop, np.array([velocity]))


def test_joints_follow_within_their_acceleration_and_brake_when_commands_cease():
    joints = _Joints(SETTINGS, 0.0)
    joints.take(command(1), 0.0)
    speeds = []
    for k in range(1, 201):
        joints.move(0.001, 0.001 * k)
        speeds.append(float(joints.velocity[0]))
    assert speeds[:3] == pytest.approx([0.01, 0.02, 0.03])
    assert max(speeds) == pytest.approx(0.5)
    # 50 ms of watchdog, then 50 ms of braking from 0.5 at 10.
    assert np.flatnonzero(np.diff(speeds) < 0)[0] == pytest.approx(49, abs=2)
    assert speeds[101:] == pytest.approx([0.0] * 99)
    assert wire.STOPPED_BY[joints.stopped] == "watchdog"
    joints.take(command(2), 0.2)
    joints.move(0.001, 0.201)
    assert (joints.stopped, joints.number) == (wire.RUNNING, 2), "the next command moves it again"


def test_told_to_stop_it_stays():
    joints = _Joints(SETTINGS, 0.0)
    joints.take(command(1), 0.0)
    joints.take(command(0, stop=True), 0.0)
    joints.take(command(2), 0.0)
    joints.move(0.01, 0.01)
    assert wire.STOPPED_BY[joints.stopped] == "told to"
    assert not joints.velocity.any()


def test_a_command_that_was_overtaken_is_not_done():
    joints = _Joints(SETTINGS, 0.0)
    joints.take(command(5, 0.1), 0.0)
    joints.take(command(4, 0.9), 0.0)
    joints.move(1.0, 0.01)
    assert joints.velocity == pytest.approx([0.1])


def test_the_network_delays_and_drops_as_asked():
    settings = RobotSettings(
        (0.0,), (1.0,), delay_s=0.01, jitter_s=0.01, dropped_fraction=0.25, seed=3
    )
    network = _Network(settings, 0)
    for k in range(2000):
        network.put(k.to_bytes(2, "little"), 0.0)
    assert network.arrived(0.0099) == []
    half = network.arrived(0.015)
    rest = network.arrived(0.0201)
    assert len(half) == pytest.approx(750, abs=80)
    assert len(half) + len(rest) == pytest.approx(1500, abs=80)
    assert half != sorted(half, key=lambda d: int.from_bytes(d, "little")), "some overtake others"


def test_when_a_robot_stood_is_read_from_its_log():
    log = np.array([[0.0, 1.0, 0], [0.1, 0.0, 0], [0.2, 1.0, 0], [0.3, 0.5, 1], [0.4, 0.0, 1]])
    assert stood_after_s(log, 0.15) == pytest.approx(0.25)
    assert stood_after_s(log[:4], 0.15) is None
    assert stood_after_s(log[1:2], 0.15) == 0.0
