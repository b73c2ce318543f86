"""What holds for all tests."""

from __future__ import annotations

from hypothesis import settings

# A shared machine may take any time for an example; how long a test takes is not what is tested.
settings.register_profile("workcell", deadline=None)
settings.load_profile("workcell")
