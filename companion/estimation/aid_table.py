"""The aid table, which intake fills and walks read: kinds of aid, columns of a row.

A row of ranges has the columns of :mod:`companion.gnss.corrected` instead of the first twelve.
"""

KIND_GNSS, KIND_BARO, KIND_MAG = 0, 1, 2
KIND_ATTITUDE, KIND_IMU = 3, 4  # only the direct filter takes these
KIND_RANGE = 5
A_VALUE, A_VELOCITY, A_VAR, A_VAR_VELOCITY = 0, 3, 6, 9
A_AZIMUTH = 3
A_SATELLITES = 12  # NaN: unknown
A_LET_GO = 13  # 1: the receiver's clock jumped in front of this epoch, nobody knows how far
A_INTERFERENCE = 14  # 0 to 1; NaN: unknown
A_CLOCK_SCALE = 15  # (3) factors on the noise of the receiver's clock from this epoch on
AID_SIZE = 18
