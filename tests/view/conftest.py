"""The short run that the tests of the trace make."""

from tests.trace.conftest import run

__all__ = ["run"]
