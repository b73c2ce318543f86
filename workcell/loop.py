"""The loop: a cell's plant, its controller, its final check and its trace, stepped tick by tick.

There is one. `run`, tele-operation, studies, sessions and environments all step a `Loop`; what differs is
who decides when the next tick comes, and who watches. Nothing in here reads a clock.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

import mujoco
from numpy.typing import ArrayLike

from workcell.control.commanded import Twist
from workcell.control.controller import Controller
from workcell.control.record import TickRecord
from workcell.errors import ControlFault, InputError
from workcell.guard.check_setup import check_settings, refusal, without_geometry
from workcell.guard.monitor import FinalCheck
from workcell.guard.supervisor import LatchedCheck
from workcell.provenance import layout, metadata
from workcell.scene.cell import Cell
from workcell.scene.compose import SCENE_FILE
from workcell.simulation.plant import Plant
from workcell.trace.writer import FLUSH_S, TraceWriter

SCENE_FOLDER = "scene"
"""Where a run folder has its scene."""
PROGRESS_TICKS = 250
"""Ticks between two reports of progress."""

Watch = Callable[[int, mujoco.MjData, Controller], bool | None]
"""Called before every tick with its number, the plant's true state, which it may not change, and the controller, to
which it may offer samples, commands and changes; True ends the run."""


@dataclass(frozen=True)
class Ending:
    """How a simulation ended."""

    ticks: int
    """Ticks done."""
    fault: str | None
    """What stopped it before its time, None if it ran to its end."""
    interrupted: bool
    """Whether a person stopped it."""
    check: dict | None
    """What the final check has to say of itself and of a halt; None if it was off."""


class Loop:
    """One simulation under way. Use it as a context: leaving it ends the checker and completes the trace.

    Args:
        cell: What is simulated.
        out: Run folder that holds the scene.
        flush_s: Simulated time of trace that a kill may cost.
        check: A final check that is running already; None starts one in lock-step if the scenario wants it.
        trace: Whether a trace is written into the run folder.
        exclusive: Whether no other simulation of this process may step as long as this one is open. MuJoCo has
            one control callback a process: loops that are not exclusive may take turns, tick by tick.

    Raises:
        InputError: an arm has no geometry the check could judge, or another simulation is under way.
    """

    def __init__(
        self,
        cell: Cell,
        out: Path,
        *,
        flush_s: float = FLUSH_S,
        check: LatchedCheck | None = None,
        trace: bool = True,
        exclusive: bool = True,
    ):
        self.cell = cell
        self._exclusive = exclusive
        self._fault: str | None = None
        self._interrupted = False
        with ExitStack() as stack:
            self.check = check or stack.enter_context(final_check(cell, out))
            self.plant, self.controller = Plant(cell), Controller(cell, check=self.check)
            # Before the trace: where another simulation is under way, nothing is written.
            if exclusive:
                stack.enter_context(self.plant.steered_by(self.controller))
            self._trace: TraceWriter | None = None
            if trace:
                self._trace = stack.enter_context(
                    TraceWriter(out, layout(cell), metadata(cell), cell.period_s, flush_s=flush_s)
                )
            self._open = stack.pop_all()

    def __enter__(self) -> Loop:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._open.__exit__(kind, error, trace)

    def close(self) -> None:
        """End the checker and complete the trace; may be called more than once."""
        self._open.close()

    def step(self, commands: Mapping[str, ArrayLike | Twist] | None = None) -> TickRecord:
        """One tick.

        Args:
            commands: What arms are to do in this tick in the place of their strategies, by name; see
                `Controller.command`.

        Returns:
            Its record, as it goes into the trace.

        Raises:
            InputError: a command is for no arm, or of another shape; nothing has been done then.
            ControlFault: a state, target or solution is not finite.
        """
        if commands:
            self.controller.command(commands)
        turn = nullcontext() if self._exclusive else self.plant.steered_by(self.controller)
        try:
            with turn:
                record = self.plant.step(self.controller)
        except ControlFault as error:
            self._fault = str(error)
            raise
        if self._trace is not None:
            self._trace.append(record)
        return record

    def run(
        self,
        *,
        watch: Watch | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> None:
        """Step to the scenario's end, unless a watch, a fault or a person ends it before.

        Args:
            watch: See `Watch`.
            progress: Called with (ticks done, ticks of a full run) now and then.
        """
        ticks = self.cell.scenario.ticks
        try:
            for tick in range(self.controller.tick, ticks):
                if watch and watch(tick, self.plant.data, self.controller):
                    break
                self.step()
                if progress and tick % PROGRESS_TICKS == 0:
                    progress(tick, ticks)
        except ControlFault:
            pass  # `ending` tells it
        except KeyboardInterrupt:
            self._interrupted = True

    def ending(self) -> Ending:
        """How it ended, or stands now."""
        fault = self._fault or "; ".join(self.controller.faults) or None
        account = None if self.check is None else self.check.account()
        return Ending(self.controller.tick, fault, self._interrupted, account)


@contextmanager
def final_check(cell: Cell, out: Path, *, live: bool = False) -> Iterator[LatchedCheck | None]:
    """Start the final check in its own process, unless the scenario switches it off.

    Args:
        cell: What is simulated.
        out: Run folder that holds the scene.
        live: Whether time goes on while the checker works; see `LatchedCheck`.

    Raises:
        InputError: an arm has no geometry the check could judge.
    """
    settings = cell.scenario.check
    if not settings.enabled:
        yield None
        return
    with FinalCheck(out / SCENE_FOLDER / SCENE_FILE, check_settings(cell)) as check:
        try:
            verdict = check.start()
        except InputError as error:
            raise refusal(cell, error.faults) from error
        if check.missing:
            raise refusal(cell, [without_geometry(check.missing)])
        if verdict.must_stop:
            raise refusal(cell, [f"{verdict.state}: {verdict.reason}"])
        yield LatchedCheck(check, period_s=cell.period_s, live=live)
