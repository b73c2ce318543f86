"""Faults put into the controller on purpose: open-loop replay must see each, and say where."""

import dataclasses
import inspect
import logging
import sys
import types

import numpy as np
import pytest

from workcell.control import controller as module
from workcell.control import pair_assignment
from workcell.control.arm_constraints import ArmConstraints
from workcell.control.controller import Controller
from workcell.control.criteria import KINDS
from workcell.control.proximity import PairGeometry
from workcell.regression import reference as regression
from workcell.regression import replay
from workcell.regression.compare import compare
from workcell.regression.excerpt import excerpt


def changed(monkeypatch, name, change):
    """Change a method of an arm's constraints."""
    law = getattr(ArmConstraints, name)
    monkeypatch.setattr(
        ArmConstraints, name, lambda self, *a, law=law, **k: change(law, self, *a, **k)
    )


def scaled_too_far(monkeypatch, duet):
    """A factor 1.01 on the scaling."""

    def mutant(law, self, *arguments):
        found = law(self, *arguments)
        factor = min(1.0, found.bound.factor * 1.01)
        return found._replace(bound=found.bound._replace(factor=factor))

    changed(monkeypatch, "allow", mutant)


def pair_dropped(monkeypatch, duet):
    """The arm does not answer for the pair that slows it down."""
    assigned = pair_assignment.assigned
    limiting = duet.trace["nurse.limiting_pair"]
    dropped = int(limiting[limiting >= 0][0])

    def mutant(*arguments):
        return [
            dataclasses.replace(
                pairs,
                owned=pairs.owned[pairs.owned != dropped],
                fixed_base=pairs.fixed_base[pairs.owned != dropped],
            )
            for pairs in assigned(*arguments)
        ]

    monkeypatch.setattr(pair_assignment, "assigned", mutant)


def sign_flipped(monkeypatch, duet):
    """The sign of one entry of G, of a joint that moves."""
    measure = PairGeometry.measure
    joint = int(np.argmax(np.abs(duet.states.qvel).max(axis=0)))

    def mutant(self, data, **how):
        found = measure(self, data, **how)
        pair = int(np.argmax(np.abs(found.jacobian[:, joint])))
        jacobian = found.jacobian.copy()
        jacobian[pair, joint] *= -1
        return dataclasses.replace(found, jacobian=jacobian)

    monkeypatch.setattr(PairGeometry, "measure", mutant)


def approaching_only(monkeypatch, duet):
    """The signed criterion swapped for the one that counts approaching pairs only."""

    def solve(law, self, previous, task, qvel, settings, kind, push=None):
        return law(self, previous, task, qvel, settings, KINDS["artc_approaching"], push)

    def state(law, self, *arguments, approaching):
        return law(self, *arguments, approaching=True)

    changed(monkeypatch, "arm_state", state)
    changed(monkeypatch, "solve", solve)


def state_delayed(monkeypatch, duet):
    """The measured state of the tick before."""
    step = Controller.step

    def mutant(self, qpos, qvel):
        late = getattr(self, "_late", (qpos, qvel))
        self._late = qpos.copy(), qvel.copy()
        return step(self, *late)

    monkeypatch.setattr(Controller, "step", mutant)


def command_delayed(monkeypatch, duet):
    """The command of the tick before, on its way out."""
    step = Controller.step

    def mutant(self, qpos, qvel):
        record = step(self, qpos, qvel)
        late = getattr(self, "_late", record.command_rad_s)
        self._late = record.command_rad_s
        return record._replace(command_rad_s=late)

    monkeypatch.setattr(Controller, "step", mutant)


MUTATIONS = {
    scaled_too_far: "scaling",
    pair_dropped: "scaling",
    sign_flipped: "proximity",
    approaching_only: "criteria",
    state_delayed: "state",
    command_delayed: "command",
}


def replayed(duet, out):
    return replay.open_loop(duet.cell, duet.states, out).trace


@pytest.mark.parametrize(
    ("mutate", "stage"), MUTATIONS.items(), ids=lambda x: getattr(x, "__name__", x)
)
def test_a_mutation_is_caught_at_its_stage(duet, tmp_path, monkeypatch, mutate, stage):
    mutate(monkeypatch, duet)
    result = compare(excerpt(replayed(duet, tmp_path)), excerpt(duet.trace), without_plant=True)
    assert result.kind == "differs"
    assert result.first is not None
    assert result.first.stage == stage, result.headline()


@pytest.mark.parametrize(
    ("mutate", "stage"), MUTATIONS.items(), ids=lambda x: getattr(x, "__name__", x)
)
def test_the_text_reference_catches_it_too(duet, tmp_path, monkeypatch, mutate, stage):
    mutate(monkeypatch, duet)
    result = regression.check_open_loop(duet.reference, tmp_path)
    assert result.kind == "differs"
    assert result.first is not None
    assert result.first.stage == stage, result.headline()


def test_a_comment_and_a_log_line_are_no_difference(duet, tmp_path, monkeypatch, caplog):
    plain = replayed(duet, tmp_path / "plain")
    source = inspect.getsource(module)
    line = "        sensed = self._sensing.measure("
    assert source.count(line) == 1
    talkative = "        # Says what it does.\n        logging.info('tick %d', self.tick)\n" + line
    copy = types.ModuleType("talkative_controller")
    copy.__dict__["logging"] = logging
    monkeypatch.setitem(sys.modules, copy.__name__, copy)
    exec(compile(source.replace(line, talkative), "talkative", "exec"), copy.__dict__)
    monkeypatch.setattr(replay, "Controller", copy.Controller)
    with caplog.at_level(logging.INFO):
        trace = replayed(duet, tmp_path / "talkative")
    assert len(caplog.records) == len(trace), "the changed controller ran"
    assert compare(excerpt(trace), excerpt(duet.trace), without_plant=True).kind == "same"
    assert trace.digest() == plain.digest(), "to the last bit, on one machine"


def test_a_pair_that_is_not_watched_any_more_is_named(duet, monkeypatch):
    kept = excerpt(duet.trace)
    layout = dataclasses.replace(kept.identity.layout, pairs=kept.identity.layout.pairs[1:])
    fewer = dataclasses.replace(kept, identity=dataclasses.replace(kept.identity, layout=layout))
    result = compare(fewer, kept)
    assert result.kind == "not comparable"
    assert " and ".join(duet.trace.layout.pairs[0]) in result.headline()
