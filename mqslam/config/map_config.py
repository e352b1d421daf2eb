"""Settings of the rendered map, and of how its places are found again."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from mqslam.config.fields import expert


class MapConfig(BaseModel):
    """Settings of the rendered map."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    cell_m: float = Field(0.2, gt=0.0, description="Side of a cell of the nav2 map [m].")
    travel_m: float = Field(
        0.1, ge=0.0, description="A scan is rendered once the sensor has moved this far since the last rendered one [m]."
    )
    travel_rad: float = Field(
        0.01, ge=0.0, description="A scan is rendered as well once the sensor has turned by this much [rad]."
    )
    keyframe_m: float = Field(
        2.5, gt=0.0, description="Path [m] between the scans that the result keeps, in which a recording is localised later."
    )
    well_seen: float = expert(
        99.0,
        ge=0.0,
        le=100.0,
        description="Percentile of the numbers of returns per cell that stands for a well-seen cell of the nav2 map. A cell "
        "counts as occupied from the square root of that number on, so that the threshold follows the speed of the drive.",
    )
    stop_s: float = expert(
        10.0, gt=0.0, description="Shortest stop that a warning names [s]; shorter ones are usual in traffic."
    )


class RecognitionConfig(BaseModel):
    """How a place is found again without a guess of where it is."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    spacing_m: float = Field(10.0, gt=0.0, description="Path [m] between the places that are described and looked up.")
    submap_m: float = Field(
        15.0, gt=0.0, description="A place is described by the returns of scans within this path [m] to either side."
    )
    range_m: float = Field(120.0, gt=0.0, description="Returns farther from a place than this [m] do not describe it.")
    rings: int = expert(40, ge=2, description="Number of rings around a place in which returns are counted.")
    sectors: int = expert(120, ge=8, description="Number of sectors around a place in which returns are counted.")
    aside_m: float = Field(
        9.0,
        ge=0.0,
        description="A place is also recognised from this far to either side [m], as from another lane. Without that, half "
        "of the places that are passed in the opposite direction are not found.",
    )
    aside_step_m: float = expert(3.0, gt=0.0, description="Distance [m] between the sideways shifts that are tried.")
    guesses: int = Field(3, ge=1, description="Number of places, the likeliest first, that psi compares with a submap.")
    search_m: float = Field(10.0, gt=0.0, description="psi searches this far [m] around such a guess.")
    search_rad: float = Field(0.1, gt=0.0, description="psi searches so far in yaw [rad] around such a guess.")
    row: int = Field(
        3,
        ge=2,
        description="Number of successive matches that must agree for a place to count as recognised: where streets look "
        "alike, single places do, too.",
    )
    gap_m: float = expert(25.0, gt=0.0, description="Longest path [m] between successive matches of a row.")
    agree_m: float = Field(
        0.5, gt=0.0, description="Distance [m] by which two matches may disagree, besides what their path adds."
    )
    agree_rad: float = Field(
        0.03, gt=0.0, description="Yaw [rad] by which two matches may disagree, besides what their path adds."
    )
    agree_share: float = Field(
        0.1,
        ge=0.0,
        description="Share of the path between two matches by which they may disagree besides, as odometry errs.",
    )
