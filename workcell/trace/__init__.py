"""What remains of a run: `load` reads a trace back; the files beside do the rest."""

from workcell.trace.table import Trace, load

__all__ = ["Trace", "load"]
