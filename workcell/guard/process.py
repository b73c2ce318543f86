"""The checker process as its parent sees it: start, wake, listen, find out how it fares, end.

Three inherited descriptors connect the two: the shared memory, a pipe whose bytes wake the
checker and whose closing ends it, and a pipe on which it greets, reports answers, and whose
closing is its obituary. A fresh interpreter is started rather than a fork or a re-import of the
parent's program, so that nothing of the controller is in the checker.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import time
import weakref
from pathlib import Path
from typing import IO, Any

import workcell
from workcell.guard.settings import CheckSettings
from workcell.guard.shared_memory import shared_file

# How long a process whose connection has closed may take to be gone, s.
FAREWELL_S = 1.0
# So many characters of what it wrote last are quoted when it fails.
QUOTE_LENGTH = 600


class CheckerProcess:
    """Starts one checker; `end` (or losing the last reference, or exiting) ends it."""

    def __init__(self, scene_xml: Path, settings: CheckSettings):
        self.memory = shared_file()
        wake_read, self._wake = os.pipe()
        self._done, done_write = os.pipe()
        self._errors: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 (closed by `_end`)
        order = {
            "scene": str(scene_xml.resolve()),
            "settings": settings.to_json(),
            "memory": self.memory,
            "wake": wake_read,
            "done": done_write,
            "parent": os.getpid(),
        }
        try:
            self._popen = subprocess.Popen(
                [sys.executable, "-P", "-m", "workcell.guard.checker", json.dumps(order)],
                stdin=subprocess.DEVNULL,
                stdout=self._errors,
                stderr=self._errors,
                pass_fds=(self.memory, wake_read, done_write),
                # A group of its own: a Ctrl-C is not for it, and if its parent dies while it is
                # suspended, the kernel hangs up and resumes orphaned groups, which ends it.
                process_group=0,
                env=_environment(),
            )
        except OSError:
            for descriptor in (self.memory, self._wake, self._done):
                os.close(descriptor)
            self._errors.close()
            raise
        finally:
            os.close(wake_read)
            os.close(done_write)
        os.set_blocking(self._wake, False)
        os.set_blocking(self._done, False)
        self._poller = select.poll()
        self._poller.register(self._done, select.POLLIN)
        self._end = weakref.finalize(
            self, _end, self._popen, (self._wake, self._done, self.memory), self._errors
        )

    @property
    def pid(self) -> int:
        """Process id."""
        return self._popen.pid

    def greeting(self, deadline_s: float) -> dict[str, Any] | str:
        """What the checker says when it is ready or refuses; or, as text, why it says nothing."""
        until_s = time.monotonic() + deadline_s
        heard = b""
        while b"\n" not in heard:
            remaining_s = until_s - time.monotonic()
            if remaining_s <= 0.0:
                return f"the checker was not ready within {deadline_s} s"
            if self._poller.poll(remaining_s * 1000.0):
                data = os.read(self._done, 65536)
                if not data:
                    return self.obituary()
                heard += data
        return json.loads(heard)

    def wake(self) -> None:
        """Tells the checker that there is a request."""
        # Full: it has wake-ups enough, it is not reading them. Broken: `listen` will say so.
        with contextlib.suppress(BlockingIOError, BrokenPipeError):
            os.write(self._wake, b".")

    def listen(self, wait_s: float) -> tuple[bool, bool]:
        """Waits for a sign of an answer. Returns (the process lives, a sign has come)."""
        if not self._poller.poll(wait_s * 1000.0):
            return True, False
        return (True, True) if os.read(self._done, 4096) else (False, False)

    def is_stopped(self) -> bool:
        """True if the process is suspended. Where the system cannot tell, False."""
        if not hasattr(os, "waitid"):
            return False
        try:
            look = os.WSTOPPED | os.WNOHANG | os.WNOWAIT
            return os.waitid(os.P_PID, self._popen.pid, look) is not None
        except ChildProcessError:
            return False

    def obituary(self) -> str:
        """How the process ended, and the last it wrote."""
        try:
            code = self._popen.wait(FAREWELL_S)
        except subprocess.TimeoutExpired:
            how = "the checker has closed its connection"
        else:
            by = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit status {code}"
            how = f"the checker process ended by {by}"
        self._errors.seek(0)
        written = self._errors.read().decode(errors="replace").strip()
        return f"{how}: ...{written[-QUOTE_LENGTH:]}" if written else how

    def end(self) -> None:
        """Ends the process and releases everything. May be called more than once."""
        self._end()


def _end(
    popen: subprocess.Popen[bytes], descriptors: tuple[int, int, int], errors: IO[bytes]
) -> None:
    wake, done, memory = descriptors
    os.close(wake)
    # The checker keeps nothing that it would have to save, and a suspended one could not be asked.
    popen.kill()
    popen.wait()
    os.close(done)
    os.close(memory)
    errors.close()


def _environment() -> dict[str, str]:
    environment = dict(os.environ)
    # The checker must find this very package, installed or not, wherever it is started from.
    root = str(Path(workcell.__file__).resolve().parent.parent)
    inherited = environment.get("PYTHONPATH")
    environment["PYTHONPATH"] = root + (os.pathsep + inherited if inherited else "")
    # Its matrices are small: threads would only take the processor from the controller.
    for library in ("OPENBLAS", "OMP", "MKL"):
        environment[f"{library}_NUM_THREADS"] = "1"
    return environment
