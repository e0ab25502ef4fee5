"""Raw satellite navigation: from pseudoranges and broadcast ephemerides to corrected ranges.

Contract of the package: ECEF (WGS-84), metres, seconds, radians; GPS time as week and second of it.
A satellite is one whole number, ``100 * (system + 1) + prn`` (:mod:`companion.gnss.systems`).
Kernels take and fill rows whose columns are named in :mod:`orbit` (``E_``, an ephemeris) and in
:mod:`corrected` (``S_``, one satellite's corrected measurement, also a row of the aid table).
What comes out depends on the stream of one receiver alone, in its own order.
"""
