"""RTCM 3 receivers: MSM4 to MSM7 observations and broadcast ephemerides, as bytes come.

The codec is our own beside pyrtcm and RTKLIB, which are the judges in its tests: see
:mod:`drivers.ublox` for why.
"""
