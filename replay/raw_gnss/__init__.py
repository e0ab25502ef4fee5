"""Readers of raw GNSS: RINEX 2 and 3, u-blox UBX, RTCM 3; one clock for a folder of them.

RINEX is read here rather than with a library: those on offer build xarray or pandas frames, a
hundred megabytes of dependencies for a table of numbers, drop lines that they cannot read without
saying so, or are kept by nobody. The wire formats of receivers, which are long and change, come
from pyubx2 and pyrtcm (extra ``gnss``).
"""
