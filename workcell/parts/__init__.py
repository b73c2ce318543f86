"""The parts by themselves, for any MuJoCo model: no scenario, no cell, no controller.

watch    pairs of geoms: distances, rows, rates, times to collision
scaler   a wanted velocity, slowed so that every time to collision is kept
gate     a command of any origin, let through only if a stop from it is verified

`from workcell import PairWatch, SpeedScaler, CommandGate, ...` is where they are meant to be taken from. The laws
behind them are those of the controller (`workcell.control.laws`); nothing is computed a second way.
"""
