"""A simulated vehicle as a process of its own, in real time and over real transports.

``python -m replay.simulator.live --help`` starts one: its CAN IMU answers as an slcan adapter on a
pseudo-terminal, its autopilot speaks MAVLink 2 over UDP. Faults come as JSON lines on its standard
input (:mod:`replay.simulator.live.faults`). What it sends is decided by pure parts that are told
the time (``autopilot``, ``can_unit``, ``slcan``, ``vehicle``); ``links`` and ``process`` own
sockets, terminals and clocks, ``client`` starts and steers it from another program.
"""
