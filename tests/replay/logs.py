"""Small logs made for the tests, each format by an independent writer.

The motion is a standstill at 47.4° N, 8.5° E, 500 m, turning at 0.1 rad/s about the vertical:
enough to tell axes, units, signs and times apart.
"""

from __future__ import annotations

import struct

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

WALL_US = 1_700_000_000_000_000
"""Wall clock at boot + 10 s, where the logs begin."""
BOOT_US = 10_000_000
DELAY_US = 20_000
"""Shortest transport, at the first message."""
ACCEL = (0.1, -0.2, -9.8)
GYRO = (0.01, -0.02, 0.1)
LAT_E7, LON_E7, ALT_MM = 474_000_000, 85_000_000, 500_000


def stamped(wall_us: int, frame: bytes) -> bytes:
    """A frame as it stands in a tlog."""
    return struct.pack(">Q", wall_us) + frame


class Autopilot:
    """Packs messages of one system as pymavlink does."""

    def __init__(self, system: int = 1, component: int = 1, *, version: int = 2) -> None:
        self.link = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
        self.version = version

    def pack(self, message: mavlink.MAVLink_message) -> bytes:
        """Bytes on the wire."""
        frame = message.pack(self.link, force_mavlink1=self.version == 1)
        self.link.seq = (self.link.seq + 1) % 256
        return bytes(frame)

    def heartbeat(self) -> bytes:
        return self.pack(mavlink.MAVLink_heartbeat_message(2, 3, 81, 0, 4, 3))

    def raw_imu(self, boot_us: int) -> bytes:
        accel = [round(a / 9.80665e-3) for a in ACCEL]
        gyro = [round(g * 1e3) for g in GYRO]
        return self.pack(mavlink.MAVLink_raw_imu_message(boot_us, *accel, *gyro, 200, -50, 430))

    def highres_imu(self, boot_us: int) -> bytes:
        return self.pack(
            mavlink.MAVLink_highres_imu_message(
                boot_us, *ACCEL, *GYRO, 0.2, -0.05, 0.43, 950.0, 0.0, 540.0, 30.0, 0x1FFF
            )
        )

    def pressure(self, boot_us: int) -> bytes:
        return self.pack(
            mavlink.MAVLink_scaled_pressure_message(boot_us // 1000, 950.25, 0.0, 3000)
        )

    def gps(self, time_usec: int, *, fix_type: int = 3, ellipsoid_mm: int = 547_500) -> bytes:
        return self.pack(
            mavlink.MAVLink_gps_raw_int_message(
                time_usec,
                fix_type,
                LAT_E7,
                LON_E7,
                ALT_MM,
                80,
                120,
                500,
                9000,
                14,
                ellipsoid_mm,
                1200,
                2500,
                300,
            )
        )

    def attitude(self, boot_us: int, yaw: float) -> bytes:
        return self.pack(
            mavlink.MAVLink_attitude_message(boot_us // 1000, 0.1, -0.05, yaw, 0.0, 0.0, 0.1)
        )

    def position(self, boot_us: int) -> bytes:
        return self.pack(
            mavlink.MAVLink_global_position_int_message(
                boot_us // 1000, LAT_E7, LON_E7, ALT_MM, 0, 10, -20, 30, 0
            )
        )

    def sim_state(self, yaw: float) -> bytes:
        q = (np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2))
        lat, lon = LAT_E7 * 1e-7, LON_E7 * 1e-7
        return self.pack(
            mavlink.MAVLink_sim_state_message(
                *q,
                0.0,
                0.0,
                yaw,
                *ACCEL,
                *GYRO,
                lat,
                lon,
                500.0,
                0.0,
                0.0,
                0.1,
                0.2,
                0.3,
                LAT_E7 + 10,
                LON_E7 - 10,
            )
        )


def tlog_frames(
    seconds: float, autopilot: Autopilot | None = None, *, rate_hz: int = 50, boot_us: int = BOOT_US
) -> list[tuple[int, bytes]]:
    """(boot time [µs], frame) of a flight: IMU at ``rate_hz``, GPS at 5 Hz sent at 10 Hz."""
    ap = autopilot or Autopilot()
    frames = [(boot_us, ap.heartbeat())]
    step = 1_000_000 // rate_hz
    fix = 0
    for i in range(int(seconds * rate_hz)):
        now = boot_us + i * step
        yaw = float(np.remainder(3.0 + 0.1 * i / rate_hz + np.pi, 2 * np.pi) - np.pi)
        frames += [(now, ap.highres_imu(now)), (now, ap.raw_imu(now)), (now, ap.sim_state(yaw))]
        if i % 5 == 0:
            frames += [(now, ap.pressure(now)), (now, ap.attitude(now, yaw))]
            if i % 10 == 0:
                fix = now
                frames.append((now, ap.position(now)))
            frames.append((now, ap.gps(fix)))
    return frames


def tlog(seconds: float) -> bytes:
    """A clean telemetry log whose transport takes ``DELAY_US`` and up to 5 ms more."""
    out = []
    for i, (boot, frame) in enumerate(tlog_frames(seconds)):
        out.append(stamped(WALL_US + boot - BOOT_US + DELAY_US + (i * 7919) % 5000, frame))
    return b"".join(out)


# --------------------------------------------------------------------------- DataFlash


def fmt(kind: int, name: str, letters: str, labels: str) -> tuple[bytes, struct.Struct]:
    """An FMT record and the packer of the bodies it declares."""
    wire = {
        "c": "h",
        "C": "H",
        "e": "i",
        "E": "I",
        "L": "i",
        "M": "B",
        "n": "4s",
        "N": "16s",
        "Z": "64s",
    }
    packer = struct.Struct("<" + "".join(wire.get(letter, letter) for letter in letters))
    body = struct.pack(
        "<BB4s16s64s", kind, packer.size + 3, name.encode(), letters.encode(), labels.encode()
    )
    return b"\xa3\x95\x80" + body, packer


def dataflash(seconds: float, *, old: bool = False) -> bytes:
    """A DataFlash log, with ``TimeMS`` stamps or with ``TimeUS`` and instances."""
    time = "I" if old else "QB"
    stamp = "TimeMS" if old else "TimeUS,I"
    gps_letters = "BIHBcLLeeEefI" if old else "QBBIHBcLLefffB"
    gps_labels = (
        "Status,TimeMS,Week,NSats,HDop,Lat,Lng,RelAlt,Alt,Spd,GCrs,VZ,T"
        if old
        else "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,U"
    )
    out = [fmt(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")[0]]
    records = {}
    for kind, name, letters, labels in (
        (130, "GPS", gps_letters, gps_labels),
        (131, "IMU", time + "ffffff", stamp + ",GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
        (136, "BARO", time + "ff", stamp + ",Alt,Press"),
        (137, "MAG", time + "hhh", stamp + ",MagX,MagY,MagZ"),
        (138, "ATT", "QccC" if not old else "IccC", stamp.split(",")[0] + ",Roll,Pitch,Yaw"),
        (139, "POS", "QLLf" if not old else "ILLf", stamp.split(",")[0] + ",Lat,Lng,Alt"),
    ):
        record, packer = fmt(kind, name, letters, labels)
        out.append(record)
        records[name] = (kind, packer)

    def add(name: str, *values: float) -> None:
        kind, packer = records[name]
        out.append(b"\xa3\x95" + bytes([kind]) + packer.pack(*values))

    for i in range(int(seconds * 50)):
        us = BOOT_US + i * 20_000
        when: tuple[int, ...] = (us // 1000,) if old else (us, 0)
        add("IMU", *when, *GYRO, *ACCEL)
        if i % 5 == 0:
            add("BARO", *when, 540.0, 95025.0)
            add("MAG", *when, 200, -50, 430)
            add("ATT", when[0], 573, -286, (35_900 + i) % 36_000)
            add("POS", when[0], LAT_E7, LON_E7, 500.0)
        if i % 10 == 0:
            ms = 302_400_000 + i * 20
            if old:
                add(
                    "GPS",
                    3,
                    ms,
                    2288,
                    14,
                    80,
                    LAT_E7,
                    LON_E7,
                    0,
                    50_000,
                    500,
                    9000,
                    -0.5,
                    us // 1000,
                )
            else:
                add("GPS", us, 0, 3, ms, 2288, 14, 80, LAT_E7, LON_E7, 50_000, 5.0, 90.0, -0.5, 1)
    return b"".join(out)


# --------------------------------------------------------------------------- ULog


def ulog(seconds: float) -> bytes:
    """A PX4 log with ``sensor_combined`` at 100 Hz and ``vehicle_gps_position`` at 5 Hz."""

    def message(kind: str, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), ord(kind)) + body

    imu = (
        "sensor_combined:uint64_t timestamp;float[3] gyro_rad;uint32_t gyro_integral_dt;"
        "int32_t accelerometer_timestamp_relative;float[3] accelerometer_m_s2;"
        "uint32_t accelerometer_integral_dt;"
    )
    gps = (
        "vehicle_gps_position:uint64_t timestamp;uint64_t time_utc_usec;int32_t lat;int32_t lon;"
        "int32_t alt;int32_t alt_ellipsoid;float s_variance_m_s;float eph;float epv;"
        "float vel_n_m_s;float vel_e_m_s;float vel_d_m_s;uint8_t fix_type;uint8_t vel_ned_valid;"
        "uint8_t satellites_used;"
    )
    out = [
        b"ULog\x01\x12\x35\x01" + struct.pack("<Q", BOOT_US),
        message("B", bytes(40)),
        message("F", imu.encode()),
        message("F", gps.encode()),
        message("A", struct.pack("<BH", 0, 0) + b"sensor_combined"),
        message("A", struct.pack("<BH", 0, 1) + b"vehicle_gps_position"),
    ]
    for i in range(int(seconds * 100)):
        us = BOOT_US + i * 10_000
        body = struct.pack("<HQ3fIi3fI", 0, us, *GYRO, 10_000, 0, *ACCEL, 10_000)
        out.append(message("D", body))
        if i % 20 == 0:
            utc = WALL_US + us - BOOT_US
            out.append(
                message(
                    "D",
                    struct.pack(
                        "<HQQ4i6f3B",
                        1,
                        us,
                        utc,
                        LAT_E7,
                        LON_E7,
                        ALT_MM,
                        547_500,
                        0.3,
                        1.2,
                        2.5,
                        0.0,
                        5.0,
                        -0.5,
                        3,
                        1,
                        14,
                    ),
                )
            )
    return b"".join(out)


# --------------------------------------------------------------------------- sensor folder


def folder(seconds: float) -> dict[str, bytes]:
    """File name → content of a sensor folder: IMU at 50 Hz, fixes at 5 Hz, some cells empty."""
    t0 = WALL_US * 1000
    imu = ["t_ns,gyro_x_radps,gyro_y_radps,gyro_z_radps,accel_x_mps2,accel_y_mps2,accel_z_mps2"]
    gnss = [
        "t_ns,lat_deg,lon_deg,alt_hae_m,vel_n_mps,vel_e_mps,vel_d_mps,num_sats,fix_type,t_rx_ns"
    ]
    baro = ["t_ns,pressure_pa"]
    for i in range(int(seconds * 50)):
        t = t0 + i * 20_000_000
        imu.append(",".join(str(v) for v in (t, *GYRO, *ACCEL)))
        if i % 10 == 0:
            down = "" if i == 10 else "-0.5"
            gnss.append(f"{t},47.4,8.5,547.5,0,5,{down},14,3,{t + 100_000_000}")
            baro.append(f"{t},95025")
    return {
        "imu.csv": ("\n".join(imu) + "\n").encode(),
        "gnss.csv": ("\n".join(gnss) + "\n").encode(),
        "baro.csv": ("\n".join(baro) + "\n").encode(),
        "vehicle.toml": b'[vehicle]\nname = "rover"\n',
    }
