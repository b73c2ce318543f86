"""A disk that is full, or read-only: said before the run, or survived in the middle of it."""

import subprocess
import sys
from types import SimpleNamespace

import pytest

from tests import cells
from workcell.errors import InputError
from workcell.signals import Layout
from workcell.trace import preflight as room
from workcell.trace.table import JOURNAL_NAME, load

LAYOUT = Layout(arms=("a",), joints=("a/j",), nq=1, nv=1, pairs=(("a/x", "floor"),))

FULL_AFTER_BYTES = 200_000
RUN = """
import resource, sys
from workcell.cli import main
resource.setrlimit(resource.RLIMIT_FSIZE, ({bytes}, {bytes}))
sys.exit(main(["run", sys.argv[1], "--out", sys.argv[2], "--set", "check.enabled=false"]))
"""


def test_a_disk_too_full_for_the_run_is_refused(tmp_path, monkeypatch):
    free = room.COPIES * 1000 * room.row_bytes(LAYOUT)
    monkeypatch.setattr(room.shutil, "disk_usage", lambda folder: SimpleNamespace(free=free))
    room.check_space(tmp_path, LAYOUT, 1000)
    with pytest.raises(InputError, match="too full: 1001 ticks need"):
        room.check_space(tmp_path, LAYOUT, 1001)


def test_a_folder_that_takes_no_file_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written to"):
        room.check_writable(tmp_path / "file" / "run")
    # A folder of the kernel, which not even root can write to.
    with pytest.raises(InputError, match="cannot be written to"):
        room.check_writable(room.Path("/proc/self"))


def test_a_disk_that_fills_up_during_a_run_leaves_what_was_written(tmp_path):
    file = cells.write(tmp_path, cells.duet())
    out = tmp_path / "run"
    # A limit on the size of files stands for a full disk: the write fails half way.
    code = RUN.format(bytes=FULL_AFTER_BYTES)
    done = subprocess.run(
        [sys.executable, "-c", code, file, out], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert JOURNAL_NAME in done.stderr
    assert "cannot be written" in done.stderr
    assert "Traceback" not in done.stderr
    trace = load(out)
    assert trace.torn_bytes == 0
    assert len(trace) > 50
    assert list(trace["tick"]) == list(range(len(trace)))
