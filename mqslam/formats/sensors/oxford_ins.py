"""The INS of Oxford's car, a NovAtel SPAN-CPT: `gps/ins.csv` and `gps/gps.csv`.

Source: robotcar-dataset.robots.ox.ac.uk/documentation. Stamps are in us; roll, pitch and yaw turn x forward, y right, z down
into north, east, down [rad].
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mqslam.core import se2
from mqslam.core.sensors import Fixes, Gyroscope
from mqslam.core.wording import count_of
from mqslam.formats.sensors.reading import Reading, make_fixes, make_gyroscope
from mqslam.formats.sensors.sensor_table import Header, SensorTable, read_sensor_table

STATUS = "ins_status"
_GOOD = "SOLUTION_GOOD"
_LONGEST_STEP_US = 1_000_000  # a heading may turn by half a turn in a longer time, and its difference would be ambiguous
_REMEDY = "give gps/ins.csv or gps/gps.csv as the Oxford RobotCar dataset has them"


def read_ins_rates(header: Header) -> Reading[Gyroscope]:
    """Reads the rates of the INS: the difference quotients of its attitude, halfway between two rows, since it states none.

    Only rows count whose status is good, and only two that follow each other in the file. The rates about x and y are those
    of roll and pitch, as long as these are small.

    Args:
        header: the first line of ins.csv.

    Raises:
        DataError: a column is missing, or fewer than two rows can be used.
    """
    table, notes = _read_good_rows(header, ("roll", "pitch", "yaw"))
    steps_us = np.diff(table.stamps_us)
    turns = se2.wrap(np.diff(table.columns[:, 1:], axis=0)) * [1.0, -1.0, -1.0]  # from x, y right, z down
    near = (steps_us > 0) & (steps_us <= _LONGEST_STEP_US)
    near &= np.isfinite(table.columns[:-1, 0]) & np.isfinite(table.columns[1:, 0])  # both are good
    rates = turns[near] / (steps_us[near, None] * 1e-6)
    middles = table.stamps_us[:-1][near] + steps_us[near] // 2
    source = f"the heading in {header.path}, differentiated"
    return make_gyroscope(header.path, source, SensorTable(middles, rates, table.unread), *notes)


def read_ins_fixes(header: Header) -> Reading[Fixes]:
    """Reads the fixes of the INS or, from gps.csv, those of its receiver with their standard deviations.

    The dataset's ground truth is made with them.

    Args:
        header: the first line of ins.csv or gps.csv.

    Raises:
        DataError: a column is missing, or no row can be used.
    """
    places, sigmas = ("latitude", "longitude"), ("latitude_sigma", "longitude_sigma")
    if STATUS in header.names:
        table, notes = _read_good_rows(header, places)
        good = np.isfinite(table.columns[:, 0])
        columns = np.column_stack([table.columns[good, 1:], np.full(np.count_nonzero(good), np.nan)])
        table = SensorTable(table.stamps_us[good], columns, table.unread)
    else:
        notes = []
        wanted = (*places, *sigmas) if set(sigmas) <= set(header.names) else places
        table = read_sensor_table(header, header.find(("timestamp", *wanted), _REMEDY))
        spread = np.sqrt(np.mean(table.columns[:, 2:] ** 2, axis=1)) if len(wanted) > 2 else np.nan
        table = table.with_columns(np.column_stack([table.columns[:, :2], np.broadcast_to(spread, len(table.columns))]))
    return make_fixes(header.path, str(header.path), table, *notes, made_truth=True)


def _read_good_rows(header: Header, names: Sequence[str]) -> tuple[SensorTable, list[str]]:
    """Reads whether the status of each row is good (1, else NaN) and some columns, with a note on those that are not."""
    columns = header.find(("timestamp", STATUS, *names), _REMEDY)
    table = read_sensor_table(header, columns, "", {columns[1]: _parse_status})
    bad = int(np.count_nonzero(~np.isfinite(table.columns[:, 0])))
    rows = count_of(len(table.columns), "row")
    return table, [f"{bad} of {rows} in {header.path} are left out: their {STATUS} is not {_GOOD}"] if bad else []


def _parse_status(text: str) -> float:
    """Returns 1 for a good status, NaN for others."""
    return 1.0 if text.strip().endswith(_GOOD) else float("nan")
