"""Files of gyroscopes, GNSS receivers and mounts, written as the descriptions of the layouts have them."""

from __future__ import annotations

from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from support.recordings import START_US

from mqslam.core.sensors import Fixes, Gyroscope

RATE = np.array([0.01, -0.02, 0.4])
"""Rates of the simulated left turn about x forward, y left and z up [rad/s], with a little roll and pitch."""
LATITUDE, LONGITUDE = 43.7821, -79.4661
INS_HEADER = (
    "timestamp,ins_status,latitude,longitude,altitude,northing,easting,down,utm_zone,"
    "velocity_north,velocity_east,velocity_down,roll,pitch,yaw"
)
GPS_HEADER = (
    "timestamp,num_satellites,latitude,longitude,altitude,latitude_sigma,longitude_sigma,altitude_sigma,northing,easting,"
    "down,utm_zone"
)


def stamps(count: int = 40, step_us: int = 10_000, start_us: int = START_US) -> NDArray[np.int64]:
    return start_us + step_us * np.arange(count)


def a_gyroscope(count: int = 40) -> Gyroscope:
    """Returns readings that change."""
    rates = np.sin(np.arange(3 * count)).reshape(-1, 3)
    return Gyroscope(stamps(count), rates, "given")


def some_fixes(count: int = 5, *, made_truth: bool = False) -> Fixes:
    """Returns fixes on a line, the first of which states no standard deviation."""
    places = np.arange(count) * 1e-5
    sigmas = np.append(np.nan, np.linspace(1.0, 2.0, count - 1))
    return Fixes(stamps(count, 300_000), LATITUDE + places, LONGITUDE - places, sigmas, "given", made_truth)


def write_lines(path: Path, *lines: str) -> Path:
    """Writes lines of text, and the folders above the file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n")
    return path


def write_imu_csv(path: Path, *rows: str) -> Path:
    return write_lines(path, "t,wx,wy,wz", *(rows or [f"{t},0.01,-0.02,0.4" for t in stamps().tolist()]))


def write_gnss_csv(path: Path, *rows: str) -> Path:
    return write_lines(path, "t,lat,lon,sigma_m", *(rows or [f"{t},{LATITUDE},{LONGITUDE},2.5" for t in stamps(5).tolist()]))


def write_applanix_imu(path: Path, rate: NDArray[np.float64], start_us: int = START_US) -> Path:
    """Writes a rate about the axes of the file, stamped in seconds, as Applanix exports it: z first."""
    x, y, z = rate.tolist()
    rows = [f"{t / 1e6:.6f},{z},{y},{x},0.1,0.2,9.8" for t in stamps(40, 5000, start_us).tolist()]
    return write_lines(path, "GPSTime,angvel_z,angvel_y,angvel_x,accelz,accely,accelx", *rows)


def write_dmu(path: Path, rate: NDArray[np.float64], start_us: int = START_US) -> Path:
    """Writes a rate about the axes of the DMU41, stamped in ns."""
    x, y, z = rate.tolist()
    rows = [f"{t * 1000 + 417},{x},{y},{z},0,0,9.8" for t in stamps(40, 5000, start_us).tolist()]
    return write_lines(path, "time,wx,wy,wz,ax,ay,az", *rows)


def write_dmi(path: Path, speed: float, start_us: int = START_US, radius_m: float = 0.34, first: int = 0) -> Path:
    """Writes 1.6 s of Boreas-RT's wheel encoder at a constant speed [m/s], stamped in seconds, from a first count on."""
    pulses = [round(first + speed * 0.01 * k / (2.0 * np.pi * radius_m) * 1024) % 2**24 for k in range(161)]
    rows = [f"{t / 1e6:.6f},{count}" for t, count in zip(stamps(161, start_us=start_us).tolist(), pulses, strict=True)]
    return write_lines(path, "GPSTime,pulse_count", *rows)


def write_applanix_gps(path: Path, latitude: float, longitude: float, start_us: int = START_US) -> Path:
    """Writes a place in the unit that it is given in, stamped in seconds."""
    header = "GPSTime,easting,northing,altitude,vel_east,vel_north,vel_up,roll,pitch,heading,angvel_z,latitude,longitude"
    rows = [
        f"{t / 1e6:.6f},1,2,3,4,5,6,0,0,0,0.4,{latitude:.12f},{longitude:.12f}" for t in stamps(4, 5000, start_us).tolist()
    ]
    return write_lines(path, header, *rows)


def write_matrix(path: Path, matrix: NDArray[np.float64]) -> Path:
    return write_lines(path, *(" ".join(f"{value:.17g}" for value in row) for row in matrix.tolist()))


def write_ins(path: Path, yaw_rate: float, statuses: tuple[str, ...] = ("INS_SOLUTION_GOOD",) * 40) -> Path:
    """Writes an INS at 50 Hz whose heading, clockwise from north, grows by a rate [rad/s] through half a turn."""
    rows = []
    for k, (t, status) in enumerate(zip(stamps(len(statuses), 20_000).tolist(), statuses, strict=True)):
        yaw = (np.pi - 0.1 + yaw_rate * 0.02 * k + np.pi) % (2.0 * np.pi) - np.pi
        rows.append(f"{t},{status},51.76,-1.25,110,5735,620,-110,30U,1,2,0,{0.001 * k},{-0.002 * k},{yaw:.12f}")
    return write_lines(path, INS_HEADER, *rows)


def write_oxford_gps(path: Path) -> Path:
    rows = [f"{t},9,51.76,-1.25,110,3.0,4.0,7.0,5735,620,-110,30U" for t in stamps(5, 200_000).tolist()]
    return write_lines(path, GPS_HEADER, *rows)


def write_mulran_imu(path: Path, rate: NDArray[np.float64] = RATE, start_us: int = START_US) -> Path:
    x, y, z = rate.tolist()
    rows = [f"{t * 1000 + 417},0,0,0.1,0.99,1,2,3,{x},{y},{z},4,5,9.8,6,7,8" for t in stamps(40, 10_000, start_us).tolist()]
    return write_lines(path, *rows)


def write_mulran_gps(path: Path, start_us: int = START_US) -> Path:
    rows = [f"{t * 1000 + 417},36.37,127.36,60.1,9.0,0,0,0,16.0,0,0,0,49.0" for t in stamps(5, 200_000, start_us).tolist()]
    return write_lines(path, *rows)


def write_radiate_messages(root: Path, rate: NDArray[np.float64] = RATE, start_us: int = START_US, count: int = 40) -> Path:
    """Writes the messages of RADIATE's car, each of them twice, with nanoseconds that lack their leading zeros."""
    folder = root / "GPS_IMU_Twist"
    folder.mkdir()
    zeros = ["0.0,0.0,0.0 "] * 3
    lines = []
    for k, stamp in enumerate(stamps(count, 50_000, start_us).tolist()):
        place = [f"{LATITUDE + 1e-6 * k:.12f},{LONGITUDE:.12f},136.1 ", "9.0,0.0,0.0 ", " 0.0,16.0,0.0 ", " 0.0,0.0,25.0 "]
        turns = f"{rate[0]:.5f},{-rate[1]:.5f},{-rate[2]:.5f} "
        text = [
            *place,
            "-0.01979,-0.00856,0.31745,0.94803 ",
            turns,
            "0.7,-0.1,-0.1 ",
            *zeros,
            *zeros,
            *zeros,
            "4.2,5.6,-0.1 ",
            turns,
        ]
        for number in (2 * k + 1, 2 * k + 2):
            write_lines(folder / f"{number:06d}.txt", *text)
            lines.append(f"Frame: {number:06d} Time: {stamp // 10**6}.{stamp % 10**6 * 1000}")
    write_lines(root / "GPS_IMU_Twist.txt", *lines)
    return folder


def sentence(body: str) -> str:
    """Returns an NMEA sentence with its checksum."""
    return f"${body}*{reduce(xor, body.encode(), 0):02X}"


def gga(clock: str, quality: int = 1, latitude: str = "4346.9260,N", longitude: str = "07927.9660,W") -> str:
    return sentence(f"GPGGA,{clock},{latitude},{longitude},{quality},09,0.9,150.0,M,-36.0,M,,")


def rmc(clock: str, date: str) -> str:
    return sentence(f"GNRMC,{clock},A,4346.9260,N,07927.9660,W,0.1,0.0,{date},,,A")
