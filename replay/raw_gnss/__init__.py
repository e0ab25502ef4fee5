"""Readers of raw GNSS: RINEX 2 and 3, u-blox UBX, GnssLogger; one clock for a folder of them.

RINEX is read here rather than with a library: those on offer build xarray or pandas frames, a
hundred megabytes of dependencies for a table of numbers, drop lines that they cannot read without
saying so, or are kept by nobody. UBX frames are read by :mod:`drivers.ublox`.
"""
