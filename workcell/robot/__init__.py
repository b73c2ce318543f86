"""Real arms: the controller in front of robots, each behind an adapter.

adapter    what your robot has to answer: read, write, stop
loop       clock, stale-state stop, live final check, trace
wire       the datagrams of the reference adapter
udp        the reference adapter, for a robot that speaks them
simulated  such a robot, in a process of its own, with a watchdog, delays and drops

Nothing in here is certified. docs/robot.md says what it is for and what has been measured.
"""
