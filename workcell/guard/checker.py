"""The process that has the last word: `python -m workcell.guard.checker`, started by monitor.py.

It compiles the scene itself, shares no code with the controller but this package, and answers
every request it is woken for: smallest distance, pair, verdict (paper, section VI: halt when
d <= d_min). It ends when its parent does: the pipe that wakes it closes with the parent.
"""

from __future__ import annotations

import json
import math
import os
import select
import signal
import sys
import time
from collections.abc import Hashable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from workcell.errors import InputError
from workcell.guard.geometry import Geometry, collect_geometry, load_scene
from workcell.guard.nearest import NearestSearch
from workcell.guard.pairs import PairTable, choose_pairs
from workcell.guard.settings import CheckSettings
from workcell.guard.shared_memory import (
    BEAT_S,
    CLOSED,
    NOBODY,
    Answer,
    Request,
    SharedMemory,
    TornRead,
)

_Grips = tuple[tuple[int, int], ...]
"""Pairs of instrument and arm between which contact is let off."""


class Checker:
    """Answers requests about one scene; the part of the checker that needs no process.

    Args:
        scene_xml: The scene, as written into a run folder.
        settings: Which arms, which limits.

    Raises:
        InputError: If scene or settings cannot be used.
    """

    def __init__(self, scene_xml: Path, settings: CheckSettings):
        self.model = load_scene(scene_xml)
        self.settings = settings
        try:
            self.geometry: Geometry = collect_geometry(self.model, settings.arms)
            self.table: PairTable = choose_pairs(
                self.model,
                self.geometry,
                settings.arms,
                settings.exemptions,
                settings.instruments,
                settings.hands,
                settings.home,
                settings.ignored,
                settings.d_min_m,
            )
        except InputError as error:
            raise InputError(error.faults, file=scene_xml) from error
        self._search = NearestSearch(
            self.model,
            self.geometry,
            self.table.watched | self.table.close,
            ceiling_m=settings.ceiling_m,
        )
        self._has_close = bool(self.table.close.any())
        self._masks: dict[Hashable, np.ndarray] = {}
        self._grips = [_Grip() for _ in settings.instruments]
        self._before: dict[int, tuple[tuple[int, _Grips], int, float]] = {}

    def answer(self, request: Request) -> Answer:
        """Checks one configuration. Depends on earlier requests only for closing speeds, and for
        hands that have just let go of an instrument."""
        started = time.perf_counter()
        settings = self.settings
        is_open = [self._is_open(k, request) for k in range(len(settings.exemptions))]
        self._search.place(request.qpos)
        gripping = self._gripping(request)
        rest = self._search.nearest(*self._watched(gripping, is_open))
        if self._has_close:
            close = self._search.nearest(self.table.close, "close")
            if close.distance_m <= min(settings.d_min_m, rest.distance_m):
                rest = close
        exempt_m, exempt_pair, fault = math.inf, (-1, -1), -1
        for k, exemption in enumerate(settings.exemptions):
            if not is_open[k]:
                continue
            found = self._search.nearest(*self._exempt(gripping, k))
            closing_m_s = self._closing_m_s(k, gripping, request, found.distance_m)
            too_near = found.distance_m <= exemption.d_min_m
            too_fast = closing_m_s > exemption.max_closing_m_s
            broken = too_near or (too_fast and found.distance_m <= exemption.near_m)
            # The first exemption whose terms are broken is the one reported, else the nearest.
            if fault < 0 and (broken or found.distance_m < exempt_m):
                exempt_m, exempt_pair = found.distance_m, found.pair or (-1, -1)
                fault = k if broken else -1
        return Answer(
            sequence=request.sequence,
            tick=request.tick,
            halt=rest.distance_m <= settings.d_min_m or fault >= 0,
            distance_m=rest.distance_m,
            pair=rest.pair or (-1, -1),
            exempt_distance_m=exempt_m,
            exempt_pair=exempt_pair,
            exemption_fault=fault,
            compute_s=time.perf_counter() - started,
        )

    def _is_open(self, k: int, request: Request) -> bool:
        opened = request.opened_ticks[k]
        return opened != CLOSED and 0 <= request.tick - opened < self.settings.expiry_ticks(k)

    def _gripping(self, request: Request) -> _Grips:
        """Every (instrument, arm) whose contact is let off: holders, and hands that just let go.

        An instrument that is handed over still touches the hand that held it. That hand is let off
        until it has once been clear of the instrument, and no longer than `release_s`.
        """
        gripping = []
        limit = self.settings.release_s / self.settings.period_s
        apart_m = self.settings.d_min_m if self.settings.clear_m is None else self.settings.clear_m
        for k, (grip, holder) in enumerate(zip(self._grips, request.holders, strict=True)):
            if holder != grip.holder:
                grip.leaving, grip.left_tick, grip.holder = grip.holder, request.tick, holder
            if grip.leaving != NOBODY:
                pairs = (self.table.held[k, grip.leaving], ("leaving", k, grip.leaving))
                clear = self._search.nearest(*pairs).distance_m > apart_m
                if clear or not 0 <= request.tick - grip.left_tick < limit:
                    grip.leaving = NOBODY
            gripping += [(k, arm) for arm in (holder, grip.leaving) if arm != NOBODY]
        return tuple(gripping)

    def _watched(self, gripping: _Grips, is_open: list[bool]) -> tuple[np.ndarray, Hashable]:
        """What is held against the check's own d_min now, as a mask and its name."""
        key = ("watched", gripping, tuple(is_open))
        if key not in self._masks:
            lifted = self._lifted_by(gripping)
            for k in np.flatnonzero(is_open):
                lifted |= self.table.exempt[k]
            self._masks[key] = self.table.watched & ~lifted
        return self._masks[key], key

    def _exempt(self, gripping: _Grips, k: int) -> tuple[np.ndarray, Hashable]:
        """What is held to the terms of exemption k now: a hand's own instrument is not."""
        key = ("exempt", gripping, k)
        if key not in self._masks:
            self._masks[key] = self.table.exempt[k] & ~self._lifted_by(gripping)
        return self._masks[key], key

    def _lifted_by(self, gripping: _Grips) -> np.ndarray:
        lifted = np.zeros_like(self.table.watched)
        for instrument, arm in gripping:
            lifted |= self.table.held[instrument, arm]
        return lifted

    def _closing_m_s(self, k: int, gripping: _Grips, request: Request, distance_m: float) -> float:
        """Mean closing speed of exemption k since the last request, m/s.

        0 for the first request of a window, and for the first after a hand has closed on an
        instrument or come clear of one: the distances then are not of the same pairs.
        """
        same, tick = (request.opened_ticks[k], gripping), request.tick
        before = self._before.get(k)
        self._before[k] = (same, tick, distance_m)
        if before is None or before[0] != same or tick <= before[1]:
            return 0.0
        return (before[2] - distance_m) / ((tick - before[1]) * self.settings.period_s)


@dataclass
class _Grip:
    """What the checker remembers of one instrument."""

    holder: int = NOBODY
    """Arm that held it at the last request."""
    leaving: int = NOBODY
    """Arm that held it before and is not clear of it yet."""
    left_tick: int = 0
    """Tick of the request that said so."""


def main() -> int:
    """Runs one checker: descriptors, scene and settings come as one JSON argument."""
    # Ctrl-C in a terminal is for the parent, whose end is also the end of this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    order = json.loads(sys.argv[1])
    settings = CheckSettings.from_json(order["settings"])
    wake, done = order["wake"], order["done"]
    faults = _Faults(settings)
    faults.at_start()
    try:
        checker = Checker(Path(order["scene"]), settings)
    except InputError as error:
        _say(done, {"refused": error.faults, "file": error.file})
        return 2
    link = SharedMemory(
        order["memory"],
        nq=checker.model.nq,
        n_exemptions=len(settings.exemptions),
        n_instruments=len(settings.instruments),
    )
    # The first check pays for page faults and caches; it is paid before the arms may move.
    idle = (CLOSED,) * len(settings.exemptions)
    lying = (NOBODY,) * len(settings.instruments)
    checker.answer(Request(0, 0, idle, np.array(checker.model.qpos0), lying))
    link.beat(time.monotonic())
    names = [piece.name for piece in checker.geometry.pieces]
    _say(
        done,
        {
            "nq": checker.model.nq,
            "pieces": names,
            "pairs": checker.table.count,
            "missing": list(checker.geometry.missing),
        },
    )
    _serve(checker, link, wake, done, order["parent"], faults)
    return 0


def _serve(
    checker: Checker, link: SharedMemory, wake: int, done: int, parent: int, faults: _Faults
) -> None:
    os.set_blocking(done, False)
    poller = select.poll()
    poller.register(wake, select.POLLIN)
    answered = 0
    while True:
        link.beat(time.monotonic())
        if not poller.poll(BEAT_S * 1000.0):
            # Another child of the parent may hold the pipe open after the parent has gone.
            if os.getppid() != parent:
                return
            continue
        if not os.read(wake, 4096):
            return
        try:
            request = link.request()
        except TornRead:
            # No answer is the answer: the parent's deadline makes it a named state.
            continue
        if request.sequence == answered:
            continue
        answered = request.sequence
        answer = checker.answer(request)
        if not faults.commit(link, answer):
            link.answer(answer)
        try:
            os.write(done, b".")
        except BlockingIOError:
            # The parent has thousands of unread bytes: it is not waiting for this one.
            pass
        except BrokenPipeError:
            return


def _say(done: int, message: dict) -> None:
    data = (json.dumps(message) + "\n").encode()
    while data:
        data = data[os.write(done, data) :]


class _Faults:
    """Misbehaves as `CheckSettings.test_fault` orders; without one it does nothing."""

    def __init__(self, settings: CheckSettings):
        self._fault = settings.test_fault

    def at_start(self) -> None:
        if self._fault is None:
            return
        if self._fault.kind == "crash_at_start":
            raise RuntimeError("crash_at_start, as test_fault orders")
        if self._fault.kind == "hang_at_start":
            time.sleep(self._fault.seconds)

    def commit(self, link: SharedMemory, answer: Answer) -> bool:
        """True if the answer has been seen to, faultily."""
        if self._fault is None or answer.sequence < self._fault.from_sequence:
            return False
        match self._fault.kind:
            case "slow":
                time.sleep(self._fault.seconds)
                return False
            case "old_sequence":
                link.answer(replace(answer, sequence=self._fault.from_sequence - 1))
            case "future_sequence":
                link.answer(replace(answer, sequence=answer.sequence + 1))
            case "not_a_number":
                link.answer(replace(answer, distance_m=math.nan))
            case "garbage":
                link.scribble()
            case "kill_self":
                os.kill(os.getpid(), signal.SIGKILL)
            case "stop_self":
                os.kill(os.getpid(), signal.SIGSTOP)
            case _:
                return False
        return True


if __name__ == "__main__":
    sys.exit(main())
