"""The bad places of an audited map as files that spreadsheets and GIS programs open."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from mqslam.auditing.judge import Audit
from mqslam.auditing.sweeps import Sweeps
from mqslam.config import AuditConfig
from mqslam.execution.files import write_json, write_text
from mqslam.report.places.spots import Spot, spot_of_window, spots_of_torn_pairs

NAMES: Final = ("bad_places.csv", "bad_places.geojson")
_COLUMNS: Final = (
    "kind",
    "torn",
    "t0",
    "t1",
    "x",
    "y",
    "yaw",
    "off_m",
    "dx",
    "dy",
    "dyaw",
    "inflation",
    "verdict",
    "description",
)
_FRAME: Final = "x and y [m] in the frame of the trajectory that was audited, not degrees on the Earth"


def list_bad_places(sweeps: Sweeps, audit: Audit, settings: AuditConfig) -> tuple[Spot, ...]:
    """Returns all that is torn and all windows of which nothing could be decided, in the order of time.

    Args:
        sweeps: what was judged.
        audit: its judgement.
        settings: of the audit.
    """
    windows = [spot_of_window(window) for window in audit.windows if window.torn or window.undecided is not None]
    return tuple(sorted([*windows, *spots_of_torn_pairs(sweeps, audit, settings)], key=lambda spot: (spot.t1, spot.kind)))


def write_bad_places(folder: Path, spots: Sequence[Spot]) -> None:
    """Writes bad places as CSV and as GeoJSON into an existing folder; without any, the files hold none.

    Args:
        folder: the folder.
        spots: the places.

    Raises:
        OutputError: a file cannot be written.
    """
    rows = [_list_values(spot) for spot in spots]
    file = io.StringIO()
    writer = csv.DictWriter(file, _COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(
        {key: f"{value:.9g}" if isinstance(value, float) else value for key, value in row.items()} for row in rows
    )
    write_text(folder / NAMES[0], file.getvalue())
    features = [
        {"type": "Feature", "geometry": {"type": "Point", "coordinates": [row["x"], row["y"]]}, "properties": row}
        for row in rows
    ]
    write_json(folder / NAMES[1], {"type": "FeatureCollection", "name": "bad places", "frame": _FRAME, "features": features})


def _list_values(spot: Spot) -> dict[str, Any]:
    """Returns a place's row: lengths in metres, angles in radians, times in seconds since the recording began."""
    x, y, yaw = spot.pose.tolist()
    dx, dy, dyaw = spot.correction.tolist()
    return {
        "kind": spot.kind,
        "torn": "unknown" if spot.unknown else str(spot.torn),
        "t0": spot.t0,
        "t1": spot.t1,
        "x": x,
        "y": y,
        "yaw": yaw,
        "off_m": spot.off_m,
        "dx": dx,
        "dy": dy,
        "dyaw": dyaw,
        "inflation": spot.inflation,
        "verdict": spot.verdict,
        "description": spot.text,
    }
