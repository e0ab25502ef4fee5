"""RINEX files: against RTKLIB's reader, and what is done about those that are broken."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyrtklib as rk
import pytest

from companion.gnss import orbit as ob
from companion.gnss.systems import C
from companion.types import LogFormatError
from replay.raw_gnss.rinex_navigation import read_navigation
from replay.raw_gnss.rinex_observations import read_observations

TCKF = "instinct-static-vn310/test/data/DataProcessor/tckf/reach-m2-01_raw_202306291111"


def _line(content: str, label: str) -> str:
    return f"{content:<60}{label:<20}\n"


OBS_3 = (
    _line("     3.03           OBSERVATION DATA    M", "RINEX VERSION / TYPE")
    + _line("G    4 C1C L1C D1C S1C", "SYS / # / OBS TYPES")
    + _line("E    2 C1X S1X", "SYS / # / OBS TYPES")
    + _line("  2023     6    29    11    12   42.0940000     GPS", "TIME OF FIRST OBS")
    + _line("", "END OF HEADER")
    + "> 2023  6 29 11 12 42.0940000  0  3\n"
    + "G 1  21487708.882 1 112918674.584 2      2685.480          40.000  \n"
    + "R 2  21487708.882 1 112918674.584 2      2685.480          40.000  \n"
    + "E10  23291359.775            41.000  \n"
    + "> 2023  6 29 11 12 43.0940000  0  1\n"
    + "G 1  21487700.882 1 112918674.584 2                        39.000  \n"
)
OBS_2 = (
    _line("     2.11           OBSERVATION DATA    G", "RINEX VERSION / TYPE")
    + _line("     6    C1    L1    D1    S1    P2    L2", "# / TYPES OF OBSERV")
    + _line("  2023     6    29    11    12   42.0940000     GPS", "TIME OF FIRST OBS")
    + _line("", "END OF HEADER")
    + " 23  6 29 11 12 42.0940000  0  2G 1G12\n"
    + f"{21487708.882:14.3f}  {112918674.584:14.3f}  {2685.480:14.3f}  {40.0:14.3f}\n\n"
    + f"{22487708.882:14.3f}  {112918674.584:14.3f}  {-685.480:14.3f}  {35.0:14.3f}\n\n"
)


def _written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "test.obs"
    path.write_text(text)
    return path


def test_observations_of_version_3(tmp_path: Path) -> None:
    raw, notes = read_observations(_written(tmp_path, OBS_3))
    assert raw.sat[:, :3].tolist() == [[101, 210, 0], [101, 0, 0]]
    assert raw.pseudorange[0, :2].tolist() == [21487708.882, 23291359.775]
    # Doppler is positive for what comes nearer.
    assert raw.rate[0, 0] == pytest.approx(-2685.480 * C / 1575.42e6)
    assert np.isnan(raw.rate[[0, 1], [1, 0]]).all()
    assert raw.cn0[1, 0] == 39.0
    assert raw.week.tolist() == [2268, 2268]
    assert raw.tow[0] == pytest.approx(4 * 86_400 + 11 * 3_600 + 12 * 60 + 42.094)
    assert notes == []


def test_observations_of_version_2(tmp_path: Path) -> None:
    raw, notes = read_observations(_written(tmp_path, OBS_2))
    assert raw.sat[:, :3].tolist() == [[101, 112, 0]]
    assert raw.pseudorange[0, :2].tolist() == [21487708.882, 22487708.882]
    assert raw.rate[0, 1] == pytest.approx(685.480 * C / 1575.42e6)
    assert notes == []


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("RINEX VERSION / TYPE", "VERSION", "'RINEX VERSION / TYPE' is missing"),
        ("3.03", "x.03", "RINEX version 'x.03' is no number"),
        ("3.03", "9.03", "readable are 2 and 3"),
        ("OBSERVATION DATA", "NAVIGATION DATA ", "type 'N', not observations"),
        ("END OF HEADER", "COMMENT", "the RINEX header does not end"),
        ("GPS  ", "UTC  ", "epochs in UTC time"),
        ("C1C", "C5Q", ""),
        (
            _line("", "END OF HEADER"),
            _line("G 100", "SYS / SCALE FACTOR") + _line("", "END OF HEADER"),
            "numbers scaled by 100",
        ),
    ],
)
def test_headers_that_cannot_be_are_one_clear_line(
    tmp_path: Path, old: str, new: str, says: str
) -> None:
    text = OBS_3.replace(old, new).replace("C1X", "C5X" if new == "C5Q" else "C1X")
    with pytest.raises(LogFormatError, match=says or "no pseudoranges of GPS L1"):
        read_observations(_written(tmp_path, text))


@pytest.mark.parametrize("wrong", ["L1C C1C D1C S1C", "S1C L1C D1C C1C", "D1C C1C L1C S1C"])
def test_columns_that_a_header_interchanges_are_no_ranges(tmp_path: Path, wrong: str) -> None:
    """Phase, Doppler or C/N0 in the place of the pseudorange: other satellites are read."""
    raw, notes = read_observations(_written(tmp_path, OBS_3.replace("C1C L1C D1C S1C", wrong)))
    assert raw.sat[:, :2].tolist() == [[210, 0]]
    assert notes == ["test.obs: 2 lines or epochs that cannot be, left out"]


@pytest.mark.parametrize("name", ["G\xb3\xb3", "G -1", "G+1", "G1.", "GG1", "G99", "G 0"])
def test_satellites_that_are_none_are_left_out(tmp_path: Path, name: str) -> None:
    """A superscript three, byte B3, is a digit to Python and no number."""
    path = tmp_path / "test.obs"
    path.write_bytes(OBS_3.replace("G 1", name).encode("latin-1"))
    assert read_observations(path)[0].sat[:, :2].tolist() == [[210, 0]]


def test_a_file_of_beidou_alone_is_in_its_own_time_unless_it_says_otherwise(tmp_path: Path) -> None:
    one = OBS_3.replace("OBSERVATION DATA    M", "OBSERVATION DATA    C")
    assert len(read_observations(_written(tmp_path, one))[0]) == 2
    silent = one.replace("TIME OF FIRST OBS", "COMMENT")
    with pytest.raises(LogFormatError, match="epochs in BDT time"):
        read_observations(_written(tmp_path, silent))


def test_broken_epochs_are_left_out_and_counted(tmp_path: Path) -> None:
    spoiled = OBS_3.replace("> 2023  6 29 11 12 43", "> 2023  6 3x 11 12 43")
    raw, notes = read_observations(_written(tmp_path, spoiled))
    assert len(raw) == 1
    assert notes == ["test.obs: 2 lines or epochs that cannot be, left out"]
    back = OBS_3.replace("11 12 43.0940000  0", "11 12 41.0940000  0")
    assert len(read_observations(_written(tmp_path, back))[0]) == 1
    far = OBS_3.replace("> 2023  6 29 11 12 43", "> 9023  6 29 11 12 43")
    assert len(read_observations(_written(tmp_path, far))[0]) == 1
    absurd = OBS_3.replace("21487700.882", "91487700.882")
    assert len(read_observations(_written(tmp_path, absurd))[0]) == 1
    cut = OBS_3[: OBS_3.index("R 2")]
    assert len(read_observations(_written(tmp_path, cut))[0]) == 1


@pytest.mark.parametrize("name", [TCKF + ".nav", "android-gnss/hour0530.23n"])
def test_ephemerides_are_those_of_rtklib(data_dir: Path, name: str) -> None:
    ours, notes = read_navigation(data_dir / name)
    assert notes == []
    nav, obs, sta = rk.nav_t(), rk.obs_t(), rk.sta_t()
    rk.readrnx(str(data_dir / name), 1, "", obs, nav, sta)
    rows = {(int(v[ob.E_SAT]), int(v[ob.E_ISSUE]), int(v[ob.E_TOE])): v for v in ours.values}
    systems = {rk.SYS_GPS: 100, rk.SYS_GAL: 200, rk.SYS_CMP: 300}
    place, clock, var = rk.Arr1Ddouble(3), rk.Arr1Ddouble(1), rk.Arr1Ddouble(1)
    out, prn, week = np.empty(8), rk.Arr1Dint(1), rk.Arr1Dint(1)
    for k in range(nav.n):
        eph = nav.eph[k]
        sat = systems[rk.satsys(eph.sat, prn)] + prn[0]
        row = rows[sat, eph.iode, round(rk.time2gpst(eph.toe, week))]
        rk.eph2pos(rk.timeadd(eph.toe, -900.0), eph, place, clock, var)
        ob.satellite_at(row, row[ob.E_WEEK], row[ob.E_TOE] - 900.0, out)
        assert week[0] == row[ob.E_WEEK]
        assert np.abs(out[:3] - [place[i] for i in range(3)]).max() < 1e-5
        assert out[6] / C + row[ob.E_GROUP_DELAY] == pytest.approx(clock[0], abs=1e-15)
        index = 1 if sat // 100 == 2 else 0  # Galileo: the second delay, of E1 and E5b
        assert eph.tgd[index] == pytest.approx(row[ob.E_GROUP_DELAY], abs=1e-20)
    assert nav.n == (ours.sat > 0).sum()


def test_navigation_files_that_cannot_be(tmp_path: Path, data_dir: Path) -> None:
    good = (data_dir / (TCKF + ".nav")).read_text()
    path = tmp_path / "test.nav"
    for text, says in (
        (good.replace("N: GNSS NAV DATA", "OBSERVATION DATA"), "type 'O', not navigation"),
        (good[: good.index("R18")], "no ephemeris of GPS, Galileo or BeiDou"),
        ("", "'RINEX VERSION / TYPE' is missing"),
    ):
        path.write_text(text)
        with pytest.raises(LogFormatError, match=says):
            read_navigation(path)
    whole, _ = read_navigation(data_dir / (TCKF + ".nav"))
    path.write_text(good[: int(len(good) * 0.8)] + "\n")
    cut, notes = read_navigation(path)
    assert len(cut) < len(whole)
    assert notes == ["test.nav: 1 records that cannot be, left out"]
