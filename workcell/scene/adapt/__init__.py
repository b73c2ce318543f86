"""Any arm file -> an arm of a cell: adapted once, beside the original, which is never touched."""

from workcell.scene.adapt.adapt import Adapted, Wishes, adapt

__all__ = ["Adapted", "Wishes", "adapt"]
