"""Satellites from broadcast ephemerides against the orbits and clocks that IGS centres published.

The records are those of the day's merged broadcast files, read as files; the positions and clocks
beside them are of the final orbits (SP3). The final orbits are of a satellite's centre of mass and
broadcast ones of its antenna, which is 0.5 to 2.8 m nearer to the Earth (igs05.atx, igs14.atx); a
broadcast orbit errs by some metres along its track, and its clock by some nanoseconds.

Sources: CDDIS brdc1820.10n with IGS igs15904.sp3 (GPS, 2010-07-01; both in RTKLIB's test data);
IGS BRDC00IGS_R_20201360000 with CODE COD0MGXFIN_20201360000 (2020-05-15; in gnss_lib_py's).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from companion.gnss import orbit as ob
from companion.gnss.systems import C, satellite_number
from companion.types import F64
from replay.raw_gnss.rinex_navigation import read_navigation

PLACE_M, CLOCK_M = 5.0, 3.0
"""Antenna and a broadcast orbit's own error; ten nanoseconds."""

BRDC_2010 = """\
     2              NAVIGATION DATA                         RINEX VERSION / TYPE
                                                            END OF HEADER
 2 10  7  1  0  0  0.0 0.269108917564D-03 0.318323145621D-11 0.000000000000D+00
    0.850000000000D+02 0.414375000000D+02 0.525557597442D-08 0.165772167412D+01
    0.232271850109D-05 0.960697804112D-02 0.617466866970D-05 0.515359739113D+04
    0.345600000000D+06-0.558793544769D-08-0.127458719764D+01 0.167638063431D-06
    0.939349150611D+00 0.249937500000D+03 0.309739903949D+01-0.838784952606D-08
   -0.232152526369D-10 0.100000000000D+01 0.159000000000D+04 0.000000000000D+00
    0.200000000000D+01 0.000000000000D+00-0.172294676304D-07 0.850000000000D+02
    0.338418000000D+06 0.400000000000D+01 0.000000000000D+00 0.000000000000D+00
11 10  7  1  0  0  0.0-0.725742429495D-04-0.261479726760D-11 0.000000000000D+00
    0.460000000000D+02 0.332187500000D+02 0.654170105954D-08-0.693611373983D-01
    0.187754631042D-05 0.107351461193D-01 0.664964318276D-05 0.515374609375D+04
    0.345600000000D+06-0.931322574616D-08-0.149503072861D+01 0.987201929092D-07
    0.887913855027D+00 0.207906250000D+03 0.813302674761D+00-0.916931051002D-08
    0.151434879299D-09 0.100000000000D+01 0.159000000000D+04 0.000000000000D+00
    0.200000000000D+01 0.000000000000D+00-0.116415321827D-07 0.460000000000D+02
    0.340908000000D+06 0.400000000000D+01 0.000000000000D+00 0.000000000000D+00
21 10  7  1  0  0  0.0-0.707716681063D-04-0.261479726760D-11 0.000000000000D+00
    0.830000000000D+02 0.357812500000D+02 0.546737059507D-08-0.879859864872D+00
    0.186264514923D-05 0.167118094396D-01 0.573694705963D-05 0.515365436363D+04
    0.345600000000D+06 0.361353158951D-06-0.124621512742D+01 0.245869159698D-06
    0.932056934084D+00 0.251843750000D+03-0.246617953725D+01-0.862071623029D-08
    0.775032283206D-10 0.100000000000D+01 0.159000000000D+04 0.000000000000D+00
    0.200000000000D+01 0.000000000000D+00-0.121071934700D-07 0.830000000000D+02
    0.338400000000D+06 0.000000000000D+00 0.000000000000D+00 0.000000000000D+00
"""
BRDC_2020 = """\
     3.04           NAVIGATION DATA     MIXED               RINEX VERSION / TYPE
                                                            END OF HEADER
G01 2020 05 15 14 00 00-3.801891580224E-04-6.480149750132E-12 0.000000000000E+00
     6.800000000000E+01 3.000000000000E+00 4.043382708834E-09-1.846405837300E+00
     1.918524503708E-07 9.843755280599E-03 4.786998033524E-06 5.153625062943E+03
     4.824000000000E+05 7.078051567078E-08-2.960347753612E+00-1.825392246246E-07
     9.803156610536E-01 2.977500000000E+02 7.755204951758E-01-7.866399095669E-09
     1.785788670980E-10 1.000000000000E+00 2.105000000000E+03 0.000000000000E+00
     2.000000000000E+00 0.000000000000E+00 5.122274160385E-09 6.800000000000E+01
     4.752180000000E+05 4.000000000000E+00
E01 2020 05 15 14 20 00-8.570236968808E-04-7.958078640513E-12 0.000000000000E+00
     3.800000000000E+01 2.040625000000E+01 3.122272912342E-09 1.142672407315E+00
     9.797513484955E-07 7.941038347781E-05 5.377456545830E-06 5.440603303909E+03
     4.836000000000E+05-5.215406417847E-08 9.539182756908E-01 3.539025783539E-08
     9.829647628508E-01 2.370937500000E+02 1.518260425275E+00-5.537016353242E-09
    -2.289381076197E-10 5.170000000000E+02 2.105000000000E+03
     3.120000000000E+00 0.000000000000E+00-1.629814505577E-09-1.629814505577E-09
     4.844750000000E+05
"""

SP3: dict[str, tuple[str, int, tuple[tuple[float, str], ...]]] = {
    "G02": (BRDC_2010, 1590, (
        (345_600.0, "-14889.160729  -5131.952946 -21416.801336    269.108429"),
        (346_500.0, "-14399.063465  -7514.993025 -21086.733714    269.111382"),
        (347_400.0, "-14035.020495  -9857.891985 -20396.129667    269.114152"),
        (348_300.0, "-13794.267656 -12114.834599 -19358.037288    269.117128"))),
    "G11": (BRDC_2010, 1590, (
        (345_600.0, " 11344.933153 -19282.775418  13781.610630    -72.573840"),
        (346_500.0, " 11735.595528 -17530.045881  15666.160706    -72.576006"),
        (347_400.0, " 12210.133388 -15597.683391  17272.311366    -72.578565"),
        (348_300.0, " 12783.374129 -13523.913444  18571.700924    -72.580790"))),
    "G21": (BRDC_2010, 1590, (
        (345_600.0, " -3009.160611  25660.056801   4821.722344    -70.769998"),
        (346_500.0, " -3459.399677  25930.705733   2024.874496    -70.772781"),
        (347_400.0, " -3846.596758  25904.498237   -808.079422    -70.775303"),
        (348_300.0, " -4204.731967  25573.742536  -3626.512794    -70.776783"))),
    "G01": (BRDC_2020, 2105, (
        (483_600.0, "  8123.100810 -18285.231815 -17510.495774   -380.196123"),
        (483_900.0, "  8701.022316 -18576.092384 -16898.786537   -380.198094"),
        (484_200.0, "  9253.794061 -18865.086630 -16254.786714   -380.200041"))),
    "E01": (BRDC_2020, 2105, (
        (483_600.0, " 27305.620056   -946.115893  11385.387364   -857.028553"),
        (483_900.0, " 27634.882590   -901.059479  10565.323369   -857.030945"))),
}  # fmt: skip
"""Broadcast file, GPS week, and by second of week: kilometres and microseconds."""


def broadcast_row(name: str, broadcast: str, folder: Path) -> F64:
    """The ephemeris of satellite ``name`` in a RINEX text, read as a file in ``folder``."""
    path = folder / "broadcast.nav"
    path.write_text(broadcast)
    messages, notes = read_navigation(path)
    assert notes == []
    [row] = messages.values[messages.sat == satellite_number(name)]
    return np.asarray(row)


@pytest.mark.parametrize("name", list(SP3))
def test_place_and_clock_are_those_of_the_final_orbits(name: str, tmp_path: Path) -> None:
    broadcast, week, published = SP3[name]
    row, out = broadcast_row(name, broadcast, tmp_path), np.empty(8)
    for second, text in published:
        x, y, z, clock_us = (float(word) for word in text.split())
        place = 1e3 * np.array([x, y, z])
        ob.satellite_at(row, float(week), second, out)
        off = out[:3] - place
        assert np.linalg.norm(off) < PLACE_M, off
        # Final clocks are without the relativity of an eccentric orbit, −2 x·v / c, and belong to
        # two frequencies, of which a user of one takes the group delay off.
        sp3_m = 1e-6 * clock_us * C - 2.0 * float(out[:3] @ out[3:6]) / C
        assert out[6] + C * row[ob.E_GROUP_DELAY] == pytest.approx(sp3_m, abs=CLOCK_M)
