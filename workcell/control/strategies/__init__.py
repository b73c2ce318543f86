"""Strategies to race against the time-to-collision strategy: one file each, found by name (`workcell.plugins`).

All of them get the same view and the same drives. Their parameters are t_min and d_min where the
law has any room for them, so that a race compares laws and not tunings (docs/strategies.md).
"""
