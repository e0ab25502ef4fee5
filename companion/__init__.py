"""companion: the navigation process beside a drone's or vehicle's autopilot.

Frames, units, time and names are laid down in :mod:`companion.types`.
"""

__version__ = "0.1.0"
