"""Holds the table of tests: what each test compares, what it tolerates, and what it cannot see.

The verdict, its pages and the documentation take the names, the tolerances and the limits of the tests from here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np

from mqslam.auditing.sweeps import Sweeps
from mqslam.auditing.verdict import Finding
from mqslam.config import AuditConfig, VerdictConfig

_Found = TypeVar("_Found")


@dataclass(frozen=True, slots=True)
class MapTest:
    """A test of a map.

    Args:
        name: key of the test in audit.json and summary.json.
        compares: the data that the test compares with each other, in words.
        blind: the faults that the test cannot see, in words.
        tolerance: returns the largest tolerated errors in position [m] and in yaw [rad] (None: no limit on the yaw); None if
            the test has no tolerance in these units.
        rate: the tolerance in words if `tolerance` is None; otherwise words that follow the tolerance.
        quantities: number of p-values by which the test may call a good map bad. The rate of false alarms is divided by the
            number of all p-values of the table.
        of_run: whether the test needs the results of a run, so that an audit cannot make it.
        is_mendable: whether mending the trajectory corrects the faults that the test finds.
        judge: judges the points of a map under its trajectory, with the settings of the audit. Only a test that a user adds
            has this function. It is None for the tests of this table, several of which use the same registrations.
    """

    name: str
    compares: str
    blind: str
    tolerance: Callable[[AuditConfig], tuple[float, float | None]] | None = None
    rate: str = ""
    quantities: int = 0
    of_run: bool = False
    is_mendable: bool = False
    judge: Callable[[Sweeps, AuditConfig], Sequence[Finding]] | None = None

    def describe_tolerance(self, settings: AuditConfig) -> str:
        """Returns the tolerance of the test in words, in metres and degrees where it has these units."""
        if self.tolerance is None:
            return self.rate
        metres, radians = self.tolerance(settings)
        turn = "" if radians is None else f" or {np.degrees(radians):.2g}°"
        return f"{metres:.2g} m{turn}{self.rate}"


_SPAN: Final = 1.5  # a span's tolerance divided by a step's tolerance: the ends of a span are farther apart
_ROW: Final = 0.4  # tolerance of the mean offset of revisits that agree, as a share of the tolerance of a single revisit

SCALE_WARN: Final = 0.002
"""A larger bias of distances, or of the direction of travel, gets the verdict `warn` [m/m]: 0.2 % or 0.11 degrees."""
TURN_WARN: Final = 8.7e-6
"""A larger drift of the yaw gets the verdict `warn` [rad/m]: 0.05 degrees in 100 m."""
LEVER_WARN: Final = 0.05
"""A larger distance of the sensor from its place by the trajectory, ahead or to a side, gets the verdict `warn` [m]."""
DELAY_WARN_S: Final = 0.01
"""A larger delay of the trajectory's stamps, late or early, gets the verdict `warn` [s]."""


def tolerate_window(settings: AuditConfig) -> tuple[float, None]:
    """Returns the root mean square distance [m] by which a window's correction may move its points; no limit on the yaw."""
    return settings.bend_m, None


def tolerate_step(settings: AuditConfig) -> tuple[float, None]:
    """Returns the root mean square distance [m] by which a step's offset may move points; no limit on the yaw."""
    return settings.jump_m, None


def tolerate_span(settings: AuditConfig) -> tuple[float, None]:
    """Returns the tolerated offset [m] of the end of a span relative to its begin; no limit on the yaw."""
    return _SPAN * settings.jump_m, None


def tolerate_sum(settings: AuditConfig) -> tuple[float, float]:
    """Returns the tolerated errors in position [m] and yaw [rad] of the end of several successive spans."""
    return settings.torn_m, 0.5 * settings.torn_rad


def tolerate_revisit(settings: AuditConfig) -> tuple[float, float]:
    """Returns the tolerated offset in position [m] and yaw [rad] between two passes of a place."""
    return settings.torn_m, settings.torn_rad


def tolerate_row(settings: AuditConfig) -> float:
    """Returns the tolerated length [m] of the mean offset of several successive revisits whose offsets agree."""
    return _ROW * settings.torn_m


TESTS: Final = (
    MapTest(
        "trajectory",
        "the poses with each other and with the scans' times: gaps, jumps that no vehicle makes, scans without a pose",
        "wrong poses on a smooth path",
        rate="0.5 m beyond what a vehicle can do; 10 % of the scans",
    ),
    MapTest(
        "frame",
        "in audits: the poses with the middles of a finished cloud's scans; a torn map with the maps under the mirrored "
        "trajectory and under yaw counted the other way",
        "a frame that is off by less than the width of a street",
        rate="0.3 of the usual distance of points from the middle of their scan; less than half of the windows with turns "
        "become whole",
    ),
    MapTest(
        "graph",
        "psi across passes, or of the whole map without passes, before and after optimisation",
        "loops that change nothing in the map",
        rate="a psi that is a tenth higher",
        of_run=True,
    ),
    MapTest(
        "tracking",
        "the status of every scan: whether it was read, kept track, and observed every direction of its motion",
        "scans that converged to a wrong pose",
        rate="no lost scan; 10 % that observe too little",
        of_run=True,
    ),
    MapTest(
        "sensors",
        "the trajectory's turns with a gyroscope's, and its turns and speed with odometry's; in a run also its distances "
        "with the distances between GNSS fixes",
        "turns that a bias of the gyroscope explains, and slip of the wheels",
        rate="0.5° in a few scans, 3 % of the turns, 0.1 s; 10 % of the speed",
    ),
    MapTest(
        "speeds",
        "each window's two middle scans, registered on each other over all plausible speeds",
        "errors that windows can measure",
        rate="errors that a window can correct; 5 % of the places",
        is_mendable=True,
    ),
    MapTest(
        "windows",
        "the map of six scans with its best map under a correction of the speed",
        "faults between windows, and drift",
        tolerate_window,
        rate=", in 5 % of the windows",
        is_mendable=True,
    ),
    MapTest(
        "shaking",
        "windows with the same windows under smoothed poses",
        "poses that err alike for a second",
        tolerate_window,
        rate=" in the median",
        quantities=1,
        is_mendable=True,
    ),
    MapTest(
        "steps",
        "the three scans before a place with the three scans after it",
        "errors that grow slowly",
        tolerate_step,
        quantities=1,
        is_mendable=True,
    ),
    MapTest(
        "spans",
        "the scans at either end of 30 m of path, or less for a sensor of short range",
        "bends over longer stretches of path",
        tolerate_span,
        rate=", twice that where a turn moves points",
        quantities=2,
        is_mendable=True,
    ),
    MapTest(
        "sums",
        "sums of successive spans over 60, 120 and 240 m of path",
        "drift over longer stretches of path",
        tolerate_sum,
        quantities=1,
        is_mendable=True,
    ),
    MapTest(
        "pooled",
        "all spans together with one scale, direction of travel, drift of yaw, place of the sensor and delay of the stamps",
        "whether the trajectory or the ranges are wrong, and errors that scale or mirror both alike",
        rate="0.2 %, 0.11°, 0.05° per 100 m, 0.05 m, 0.01 s",
        quantities=6,
        is_mendable=True,
    ),
    MapTest(
        "revisits",
        "two passes of a place, and the mean of successive revisits that agree",
        "drift where no place is passed twice",
        tolerate_revisit,
        quantities=1,
        is_mendable=True,
    ),
)
"""All tests, in the order in which a fault found by one test may explain faults found by later tests."""

_ORDER: Final = {test.name: number for number, test in enumerate(TESTS)}
_QUANTITIES: Final = sum(test.quantities for test in TESTS)


def apply_tolerance(settings: AuditConfig, limits: VerdictConfig) -> AuditConfig:
    """Returns settings in which all tolerances are scaled by one factor to make `torn_m` equal to `limits.tolerance_m`.

    If `limits.tolerance_m` is None, the settings stay as they are.
    """
    if limits.tolerance_m is None:
        return settings
    factor = limits.tolerance_m / settings.torn_m
    names = ("bend_m", "jump_m", "torn_m", "torn_rad")
    return settings.model_copy(update={name: factor * getattr(settings, name) for name in names})


def share_of_false_alarms(limits: VerdictConfig) -> float:
    """Returns the probability with which each p-value of the table (see `MapTest.quantities`) may call a good map bad."""
    return limits.false_alarms / _QUANTITIES


def sort_tests(found: Mapping[str, list[_Found]]) -> dict[str, list[_Found]]:
    """Returns the findings by name of the test, sorted in the order of the table, with the user's tests last.

    Tests without findings are left out.
    """
    return {name: found[name] for name in sorted(found, key=lambda name: _ORDER.get(name, len(_ORDER))) if found[name]}
