"""MAVLink 1 and 2 as a pure codec: bytes to frames to columns, without sockets or clocks.

``framer`` finds and checks frames, ``dialect`` knows the messages' layouts, ``columns`` turns the
frames of one message into a structured array. Sockets and serial devices live elsewhere.
"""
