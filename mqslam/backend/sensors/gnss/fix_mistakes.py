"""What fixes that contradict the radar may be mistaken in: their clock, or latitude and longitude in the other's place."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from mqslam.backend.sensors.gnss.alignment import measure_residual
from mqslam.core import se2
from mqslam.core.sensors.clock_offsets import KNOWN_S, describe_offset
from mqslam.core.sensors.fixes import Fixes
from mqslam.core.sensors.tangent_plane import TangentPlane

# With fewer fixes than this within the recording they are not used: so few fit many trajectories.
FEWEST = 10
# Fixes are not used if half of them lie farther from the trajectory than this share of its path: no trajectory drifts so
# much.
LARGEST_SHARE = 0.05
# Fixes are not used if the trajectory spreads over less than this many times the distance that half of them lie from it,
# since they would say nothing of its heading.
LEAST_SPREAD = 5.0

_MOST_FIXES: Final = 400  # numerical: as many show whether they fit
_BETTER: Final = 0.5  # what a mistake must leave at most of the differences, as a share, to be named
SWAPPED: Final = "they fit if their latitude is the longitude and the other way round"


def find_mistake(fixes: Fixes, times: NDArray[np.float64], starts: NDArray[np.float64], chain: se2.Array) -> str:
    """Finds with which usual mistake fixes would fit a trajectory far better; "" where there is none.

    Args:
        fixes: of the receiver, of which there is one at least.
        times: (F,) of the fixes [s], increasing.
        starts: (N,) of the scans [s], increasing.
        chain: (N, 3) their poses.
    """
    path_m = float(se2.step_lengths(chain).sum())

    def misfit(times: NDArray[np.float64], positions: NDArray[np.float64], *, must_fit: bool = True) -> float:
        """Returns how far from the trajectory half of the fixes lie at least [m]; inf where that is no fit, but must be."""
        inside = np.flatnonzero((starts[0] <= times) & (times <= starts[-1]))
        if len(inside) < FEWEST:
            return np.inf
        inside = inside[:: 1 + len(inside) // _MOST_FIXES]
        points = se2.interpolate(starts, chain, times[inside])[:, :2]
        usual_m = measure_residual(points, positions[inside])
        spread_m = float(np.hypot(*np.ptp(points, axis=0)))
        fits = usual_m <= LARGEST_SHARE * path_m and spread_m >= LEAST_SPREAD * usual_m
        return usual_m if fits or not must_fit else np.inf

    plane = TangentPlane.at_middle(fixes)
    positions = plane.project(fixes.latitudes, fixes.longitudes)
    otherwise = [misfit(times, positions * [1.0, side], must_fit=False) for side in (1.0, -1.0)]  # or mirrored
    found = [(misfit(times - late_s, positions), describe_clock(late_s)) for late_s in KNOWN_S]
    if np.abs(fixes.longitudes).max() <= 90.0:
        swapped = TangentPlane(plane.longitude, plane.latitude).project(fixes.longitudes, fixes.latitudes)
        found.append((misfit(times, swapped), SWAPPED))
    least, mistake = min(found)
    return mistake if least < _BETTER * min(otherwise) else ""


def describe_clock(late_s: float) -> str:
    """Returns in words that fixes fit once their clock is put right."""
    return f"they fit if their stamps are {describe_offset(late_s)}: add {-late_s:.0f} s to them"
