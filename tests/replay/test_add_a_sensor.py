"""The worked example of adding a sensor: its codec, and the example as a user runs it."""

from __future__ import annotations

import importlib.util
import json
import math
import subprocess
import sys
from functools import reduce
from operator import xor
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from companion.types import GnssSamples
from replay.reader import read_log


@pytest.fixture(scope="module")
def example(root: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("example", root / "examples" / "nmea_gnss.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def nmea(gnss: GnssSamples) -> list[str]:
    """Its fixes as GGA sentences behind their times of arrival; the geoid 47.5 m up."""

    def angle(value: float, digits: int, signs: str) -> str:
        degrees, minutes = divmod(abs(math.degrees(value)) * 60.0, 60.0)
        return f"{int(degrees):0{digits}d}{minutes:010.7f},{signs[int(value < 0)]}"

    lines = []
    for at in range(len(gnss)):
        known = gnss.fix_type[at] >= 3
        place = f"{angle(gnss.lat[at], 2, 'NS')},{angle(gnss.lon[at], 3, 'EW')}" if known else ",,,"
        height = f"{gnss.height[at] - 47.5:.3f},M,47.5,M" if known else ",M,,M"
        text = f"GPGGA,120000.00,{place},{int(known)},{gnss.num_sats[at]:02d},0.9,{height},,"
        lines.append(f"{gnss.t_rx_ns[at]} ${text}*{reduce(xor, text.encode()):02X}")
    return lines


def test_the_codec_gives_back_what_was_sent(example: ModuleType, sample_flight: Path) -> None:
    [vehicle] = read_log([sample_flight]).vehicles
    sent = vehicle.gnss[0].take(vehicle.gnss[0].fix_type >= 3)
    lines = nmea(vehicle.gnss[0])
    got, malformed = example.decode(lines)
    assert malformed == 0
    np.testing.assert_array_equal(got.t_ns, sent.t_rx_ns)
    # Seven decimals of a minute are 0.2 mm.
    np.testing.assert_allclose(got.lat, sent.lat, rtol=0, atol=1e-10)
    np.testing.assert_allclose(got.lon, sent.lon, rtol=0, atol=1e-10)
    np.testing.assert_allclose(got.height, sent.height, rtol=0, atol=6e-4)


def test_broken_sentences_are_counted_and_left_out(
    example: ModuleType, sample_flight: Path
) -> None:
    [vehicle] = read_log([sample_flight]).vehicles
    good = nmea(vehicle.gnss[0].take(slice(0, 4)))
    broken = [good[0].replace("GPGGA,12", "GPGGA,13"), good[1][:40], "17 $GPGGA,,*", "", "x $GPRMC"]
    got, malformed = example.decode([*broken, *good])
    assert len(got) == 4
    assert malformed == 3
    assert len(example.decode([])[0]) == 0


def test_the_example_navigates_by_its_receiver(root: Path) -> None:
    command = ["examples/nmea_gnss.py", "replay/data/sample-flight.tlog", "examples/receiver.nmea"]
    done = subprocess.run(
        [sys.executable, *command], capture_output=True, text=True, check=True, cwd=root
    )
    first, second = done.stdout.splitlines()
    assert first == "131 fixes by NMEA, 0 broken sentences"
    # Once a second, position only, no standard deviations: a metre more than with the receiver
    # that gives velocity five times a second (0.94 m).
    assert json.loads(second)["position_rmse_m"]["horizontal"] < 3.0


def test_it_is_short(root: Path) -> None:
    assert len((root / "examples" / "nmea_gnss.py").read_text().splitlines()) < 60
