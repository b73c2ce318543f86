"""Machine code of laws is found only where nothing that it was made from has changed."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import workcell.control.laws
from workcell.control.laws import arithmetic, cache_folder, cache_key, law

PACKAGE = Path(workcell.control.laws.__file__).parent

TWO_FILES = {
    "inner.py": "from laws import law\n\n\n@law\ndef inner(x):\n    return 2.0 * x\n",
    "outer.py": "from laws import law\nfrom laws.inner import inner\n\n\n@law\ndef outer(x):\n    return inner(x) + 1.0\n",
}


@pytest.fixture
def copy(tmp_path):
    """The decorator with two laws of its own, of which one calls the other."""
    folder = tmp_path / "laws"
    folder.mkdir()
    shutil.copy(PACKAGE / "__init__.py", folder)
    for name, text in TWO_FILES.items():
        (folder / name).write_text(text)
    return folder


def outer(copy: Path, **environment: str) -> tuple[str, str]:
    """`outer(1.0)` in a process of its own, and what that says on standard error."""
    done = subprocess.run(
        [sys.executable, "-c", "from laws.outer import outer; print(outer(1.0))"],
        cwd=copy.parent, env=os.environ | {"PYTHONPATH": str(copy.parent)} | environment,
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    return done.stdout.strip(), done.stderr


def test_a_changed_callee_in_another_file_is_compiled_anew(copy):
    value, said = outer(copy)
    assert value == "3.0"
    assert said.count("\n") == 1
    assert said.startswith("compiling the laws")
    assert outer(copy) == ("3.0", "")  # loaded: nothing is compiled
    inner = copy / "inner.py"
    stamp = inner.stat()
    inner.write_text(TWO_FILES["inner.py"].replace("2.0", "2.5"))
    # The same size and time stamp: only the text tells. Python's own byte code would not see it either.
    os.utime(inner, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
    for compiled in (copy / "__pycache__").glob("inner.*.pyc"):
        compiled.unlink()
    assert outer(copy)[0] == "3.5"


def test_without_numba_s_compiler_the_same_functions_run(copy):
    assert outer(copy, NUMBA_DISABLE_JIT="1") == ("3.0", "")
    assert not list(copy.glob("__pycache__/laws-*"))


def test_the_folder_is_named_by_the_hash_and_holds_the_code(copy):
    outer(copy)
    (folder,) = copy.glob("__pycache__/laws-*")
    assert list(folder.glob("**/*.nbi"))
    assert cache_folder().name == f"laws-{cache_key()}"


def test_a_package_that_cannot_be_written_uses_the_user_s_cache(copy, tmp_path):
    (copy / "__pycache__").write_text("no folder")
    value, _ = outer(copy, XDG_CACHE_HOME=str(tmp_path / "home"))
    assert value == "3.0"
    assert list((tmp_path / "home" / "workcell").glob("laws-*/**/*.nbi"))


def test_division_by_zero_is_as_in_numpy():
    @law
    def quotient(a, b):
        return a / b

    assert quotient(1.0, 0.0) == float("inf")


def test_the_arithmetic_is_named():
    assert arithmetic().startswith("compiled by numba ")
