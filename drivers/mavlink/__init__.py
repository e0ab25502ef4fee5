"""MAVLink 1 and 2 in three layers, none of which knows the others' business.

- Codec, pure: ``framer`` finds and checks frames, ``dialect`` knows the messages' layouts,
  ``columns`` turns the frames of one message into a structured array, ``samples`` gives them units
  (logs are read with these too), ``packer`` and ``signing`` make frames.
- ``session``, pure: one autopilot behind one link. ``converter`` turns what it sends into samples,
  ``boot_clock`` and ``timesync`` bring its time onto ours, ``rates`` asks for messages.
- ``endpoint``: sockets and serial devices, without a thought about what passes through.
"""
