"""The controller's side of the final check: ask, wait no longer than agreed, believe nothing odd.

Joint positions go in, a `Verdict` comes out: clear, halt, or the name of what is wrong with the
checker. Headless runs ask in lock-step (`check`), so that a trace does not depend on how fast
the checker was; live runs look without waiting (`look`, made of `poll`
and `post`). Section VI of the paper.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workcell.errors import InputError
from workcell.guard.judge import judge, missing_reason
from workcell.guard.latency import Latency, LatencyLog
from workcell.guard.process import CheckerProcess
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
from workcell.guard.verdict import CheckState, Verdict


class FinalCheck:
    """A checker process and what can be asked of it. Use as a context manager.

    Args:
        scene_xml: The composed scene, loadable with plain `MjModel.from_xml_path`.
        settings: Arms, limits, deadlines, exemptions.
    """

    def __init__(self, scene_xml: Path, settings: CheckSettings):
        self._scene_xml = Path(scene_xml)
        self._settings = settings
        self._process: CheckerProcess | None = None
        self._link: SharedMemory | None = None
        self._pieces: tuple[str, ...] = ()
        self._pair_count = 0
        self._missing: tuple[str, ...] = ()
        self._opened = [CLOSED] * len(settings.exemptions)
        self._holders = [NOBODY] * len(settings.instruments)
        self._sequence = 0
        self._posted_at_s = 0.0
        self._tick = -1
        self._last: Answer | None = None
        self._nq = 0
        self._old_answers = 0
        self._given_up = False
        self._log = LatencyLog()
        self._down = "start() has not been called"

    def __enter__(self) -> FinalCheck:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # Life --------------------------------------------------------------------------------------

    def start(self) -> Verdict:
        """Starts the checker and waits until it is ready.

        Returns:
            `clear` (nothing is checked yet), `no_geometry`, `failed_to_start`, or `off`.

        Raises:
            InputError: If scene or exemptions cannot be used; names what and where.
        """
        if not self._settings.enabled:
            return self._fault(CheckState.OFF, "the final check is switched off")
        if self._process is not None:
            raise RuntimeError("start() was called twice")
        self._process = CheckerProcess(self._scene_xml, self._settings)
        greeting = self._process.greeting(self._settings.start_deadline_s)
        if isinstance(greeting, str):
            self.close()
            self._down = greeting
            return self._fault(CheckState.FAILED_TO_START, greeting)
        if "refused" in greeting:
            self.close()
            self._down = "the input was refused"
            raise InputError(greeting["refused"], file=greeting["file"])
        self._nq = greeting["nq"]
        self._pieces = tuple(greeting["pieces"])
        self._pair_count = greeting["pairs"]
        self._missing = tuple(greeting["missing"])
        self._link = SharedMemory(
            self._process.memory,
            nq=self._nq,
            n_exemptions=len(self._settings.exemptions),
            n_instruments=len(self._settings.instruments),
        )
        if self._missing:
            return self._fault(CheckState.NO_GEOMETRY, missing_reason(self._missing))
        return self._fault(CheckState.CLEAR, "the checker is ready")

    def close(self) -> None:
        """Ends the checker process, whatever state it is in. May be called more than once."""
        if self._link is not None:
            self._link.close()
            self._link = None
        if self._process is not None:
            self._process.end()
            self._process = None
            self._down = "the check has been closed"

    @property
    def pid(self) -> int | None:
        """Process id of the checker; None while there is none."""
        return self._process.pid if self._process else None

    @property
    def pieces(self) -> tuple[str, ...]:
        """Names of the high-resolution pieces."""
        return self._pieces

    @property
    def pair_count(self) -> int:
        """Number of watched piece pairs."""
        return self._pair_count

    @property
    def missing(self) -> tuple[str, ...]:
        """Bodies and arms for which there is no high-resolution geometry."""
        return self._missing

    @property
    def latency(self) -> Latency:
        """How long answers took so far."""
        return self._log.summary()

    # Exemptions --------------------------------------------------------------------------------

    def open_exemption(self, name: str, tick: int) -> None:
        """Opens the window of a declared exemption; it expires by itself.

        Raises:
            InputError: If no exemption of that name is declared.
        """
        self._opened[self._settings.exemption_index(name)] = tick

    def close_exemption(self, name: str) -> None:
        """Closes the window of a declared exemption; harmless if it is closed already."""
        self._opened[self._settings.exemption_index(name)] = CLOSED

    def exemption_state(self, name: str, tick: int) -> str:
        """`closed`, `open`, or `expired` (opened, never closed, and over) at a tick."""
        index = self._settings.exemption_index(name)
        opened = self._opened[index]
        if opened == CLOSED:
            return "closed"
        return "open" if tick - opened < self._settings.expiry_ticks(index) else "expired"

    # Instruments -------------------------------------------------------------------------------

    def set_holder(self, instrument: str, arm: str | None) -> None:
        """From the next request on, this arm holds a declared instrument; None: it lies.

        Raises:
            InputError: If no instrument or no arm of that name is declared.
        """
        index = self._settings.instrument_index(instrument)
        self._holders[index] = NOBODY if arm is None else self._settings.arm_index(arm)

    # Questions ---------------------------------------------------------------------------------

    def check(self, tick: int, qpos: NDArray[np.float64]) -> Verdict:
        """Lock-step: on every `every_ticks`-th tick asks and waits; between, the last verdict ages.

        Once the checker has failed to answer in time, it is not waited for again until it has.
        """
        if not self._settings.enabled:
            return self._fault(CheckState.OFF, "the final check is switched off")
        self._tick = tick
        if self._last is not None and not self._given_up and tick % self._settings.every_ticks:
            return self._judge(self._last)
        fault = self.post(tick, qpos)
        if fault is not None:
            return fault
        wait_s = 0.0 if self._given_up else self._settings.lockstep_deadline_s
        verdict = self._await(wait_s)
        self._given_up = self._last is None or self._last.sequence != self._sequence
        return verdict

    def look(self, tick: int, qpos: NDArray[np.float64]) -> Verdict:
        """Free-run: reads what the checker has answered, then hands over the configuration (nq,) of this tick.

        Only the first answer is waited for, since nothing may move before it has been looked at once.
        """
        seen = self.poll(tick) if self._sequence else None
        return self.post(tick, qpos) or seen or self.poll(tick)

    def post(self, tick: int, qpos: NDArray[np.float64]) -> Verdict | None:
        """Free-run: hands over a configuration (nq,) unless one is still being checked.

        Returns:
            None, or the verdict if the configuration cannot be handed over at all.
        """
        if not self._settings.enabled:
            return None
        self._tick = tick
        if self._process is None or self._link is None:
            return self._fault(CheckState.FAILED_TO_START, self._down)
        started = time.thread_time()
        qpos = np.asarray(qpos, dtype=float)
        if qpos.shape != (self._nq,):
            reason = f"qpos has shape {qpos.shape}, the scene needs ({self._nq},)"
            return self._fault(CheckState.NONSENSE, reason)
        if not np.isfinite(qpos).all():
            where = np.flatnonzero(~np.isfinite(qpos)).tolist()
            return self._fault(CheckState.NONSENSE, f"qpos{where} is not finite")
        if self._is_waiting and not self._given_up:
            return None
        self._sequence += 1
        self._posted_at_s = time.monotonic()
        self._link.post(
            Request(self._sequence, tick, tuple(self._opened), qpos, tuple(self._holders))
        )
        self._process.wake()
        self._old_answers = 0
        self._log.posted(time.thread_time() - started)
        return None

    def poll(self, tick: int | None = None) -> Verdict:
        """Free-run: the newest verdict, without waiting; only the first answer is waited for, for `lockstep_deadline_s` at most.

        Args:
            tick: The current tick; the one last posted if left out.
        """
        if not self._settings.enabled:
            return self._fault(CheckState.OFF, "the final check is switched off")
        if tick is not None:
            self._tick = tick
        # The first answer comes before anything moves: here a slow start costs time, not distance.
        first = self._last is None and self._sequence > 0
        verdict = self._await(self._settings.lockstep_deadline_s if first else 0.0)
        if verdict.must_stop:
            return verdict
        if verdict.age_ticks > self._settings.max_age_ticks:
            reason = (
                f"the newest answer is {verdict.age_ticks} ticks old, "
                f"{self._settings.max_age_ticks} are allowed"
            )
            return replace(verdict, state=CheckState.STALE, reason=reason)
        return verdict

    # Inside ------------------------------------------------------------------------------------

    @property
    def _is_waiting(self) -> bool:
        return self._sequence > 0 and (self._last is None or self._last.sequence < self._sequence)

    def _await(self, wait_s: float) -> Verdict:
        """The verdict on the newest request, waiting for its answer if it is not there yet."""
        process, link = self._process, self._link
        if process is None or link is None:
            return self._fault(CheckState.FAILED_TO_START, self._down)
        until_s = time.monotonic() + wait_s
        while True:
            alive, woken = process.listen(max(0.0, until_s - time.monotonic()))
            started = time.thread_time()
            if not alive:
                return self._fault(CheckState.LOST, process.obituary())
            if woken:
                try:
                    answer = link.newest_answer()
                except TornRead as error:
                    reason = f"the answer cannot be read: {error}"
                    return self._fault(CheckState.NONSENSE, reason)
                if answer.sequence > self._sequence:
                    reason = (
                        f"the answer is for request {answer.sequence}, "
                        f"only {self._sequence} were made"
                    )
                    return self._fault(CheckState.NONSENSE, reason)
                if answer.sequence == self._sequence and self._is_waiting:
                    self._last = answer
                    verdict = self._judge(answer)
                    self._log.answered(
                        time.monotonic() - self._posted_at_s,
                        answer.compute_s,
                        time.thread_time() - started,
                    )
                    return verdict
                self._old_answers += woken
            if time.monotonic() >= until_s:
                return self._unanswered(process, link, wait_s)

    def _unanswered(self, process: CheckerProcess, link: SharedMemory, wait_s: float) -> Verdict:
        """The verdict when nothing new has come: the last one, or what is wrong."""
        if process.is_stopped():
            return self._fault(CheckState.STOPPED, "the checker process is suspended")
        now_s = time.monotonic()
        if not self._is_waiting:
            silent_s = now_s - link.last_beat_s
            if silent_s > self._settings.deadline_s + BEAT_S:
                reason = f"the checker has been silent for {silent_s:.3f} s"
                return self._fault(CheckState.LATE, reason)
            if self._last is None:
                return self._fault(CheckState.LATE, "nothing has been asked yet")
            return self._judge(self._last)
        waited_s = now_s - self._posted_at_s
        allowed_s = max(wait_s, self._settings.deadline_s)
        if waited_s >= allowed_s:
            if self._old_answers:
                reason = f"answers keep coming, but none for request {self._sequence}"
                return self._fault(CheckState.STALE, reason)
            reason = f"no answer for {waited_s:.3f} s, {allowed_s:.3f} s are allowed"
            return self._fault(CheckState.LATE, reason)
        if self._last is None:
            return self._fault(CheckState.LATE, "the first answer has not come yet")
        return self._judge(self._last)

    def _judge(self, answer: Answer) -> Verdict:
        expired = [
            exemption.name
            for exemption in self._settings.exemptions
            if self.exemption_state(exemption.name, answer.tick) == "expired"
        ]
        return judge(
            answer,
            self._settings,
            pieces=self._pieces,
            missing=self._missing,
            expired=expired,
            tick=self._tick,
        )

    def _fault(self, state: CheckState, reason: str) -> Verdict:
        """A verdict without a distance: what is wrong, and when an answer was last had."""
        if self._last is None:
            return Verdict(state, 0, -1, 0, None, None, None, reason)
        last = self._last
        return Verdict(
            state, last.sequence, last.tick, self._tick - last.tick, None, None, None, reason
        )
