"""The live process: the only owner of clocks, threads, sockets and devices.

links → :mod:`~companion.runtime.loop` → :mod:`~companion.runtime.core` → log, publishers

The core is everything between "these bytes arrived at that time" and "this came out", and knows no
clock; the loop around it is thin.
"""
