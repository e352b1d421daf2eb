"""Settings of the front ends besides psi, and of how the errors of all of them are learnt."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from mqslam.config.fields import expert


class CalibrationConfig(BaseModel):
    """How the size of a front end's errors is learnt from motions that were measured twice."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    moved_m: float = expert(
        0.1,
        ge=0.0,
        description="Shorter motions tell nothing [m]: while the vehicle stands, both measurements see the same again.",
    )
    trusted: float = expert(
        5.0,
        gt=0.0,
        description="Number of motions that it takes to outweigh the covariances that the front end states itself. These "
        "were off by a factor of three and more, so that they are worth a few motions only.",
    )
    gross: float = expert(
        100.0,
        gt=1.0,
        description="Squared differences over this many times the median one are cut down to it: a wrong match says nothing "
        "of the right ones.",
    )
    shared: float = expert(
        0.2,
        ge=0.0,
        lt=1.0,
        description="Share of the variance of a motion that its measurements by psi, forward and backward in time, have in "
        "common, so that how far they are apart does not show it. It is unknown; 0 to 0.5 was found in simulated cities.",
    )


class ScanMatchingConfig(BaseModel):
    """Settings that the front ends share which match scan after scan to a map of their own."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    voxel_size_m: float = Field(
        1.0, gt=0.0, description="Side of the voxels of its map [m]. Values of 0.5 to 2.0 measure alike on radar returns."
    )
    max_range_m: float = Field(100.0, gt=0.0, description="Farther returns are dropped [m].")

    fewest_matched: int = expert(20, ge=1, description="A scan with fewer correspondences than this does not match.")
    surface_points: int = expert(
        10, ge=2, description="Number of map points that show how the surface around the nearest one runs."
    )
    flattest: float = expert(
        0.01,
        gt=0.0,
        lt=1.0,
        description="Least variance of a surface's points across it, as a share of that along it.",
    )
    start_scans: int = expert(10, ge=2, description="Number of scans from which a front end finds its first motion.")
    start_returns: int = expert(
        20, ge=1, description="Fewest returns in all scans from which a front end finds its first motion."
    )
    start_step_m: float = expert(2.0, gt=0.0, description="Travel per turn between the speeds that a start tries [m].")
    start_as_good: float = expert(
        0.95,
        gt=0.0,
        le=1.0,
        description="A start at a slower speed is as good if it matches this share of the points that the best start "
        "matches.",
    )
    coast_vx: float = expert(
        1.0, gt=0.0, description="Standard deviation of the forward speed where it is only predicted [m/s]."
    )
    coast_vy: float = expert(
        0.3, gt=0.0, description="Standard deviation of the sideways speed where it is only predicted [m/s]."
    )
    coast_omega: float = expert(
        0.1, gt=0.0, description="Standard deviation of the yaw rate where it is only predicted [rad/s]."
    )
    longest_coast_s: float = expert(
        60.0,
        gt=0.0,
        description="A longer gap is a pause or a jump of the clock [s]. After it the sensor is taken to be at rest.",
    )
    backward_scans: int = expert(
        80,
        ge=2,
        description="Number of scans in a row that are followed backwards in time, too, to learn how large errors are.",
    )
    backward_every: int = expert(
        1000,
        ge=10,
        description="One such stretch is followed in every so many scans; errors are as large everywhere.",
    )
    backward_warm_up: int = expert(
        20, ge=0, description="Number of scans by which such a stretch begins earlier, while its map is still thin."
    )
    gap_turns: float = expert(
        0.5, gt=0.0, description="Missing time between two scans from which it counts as a gap, in turns of the radar."
    )


class KissIcpConfig(ScanMatchingConfig):
    """Settings of the KISS-ICP front end."""

    deskew: bool = Field(True, description="Whether each return is moved by the last motion to the end of its scan.")
    config_file: Path | None = Field(
        None,
        description="YAML file of KISS-ICP's own settings, which takes the place of voxel_size_m, max_range_m and "
        "deskew; null takes those.",
    )


class Open3dIcpConfig(ScanMatchingConfig):
    """Settings of the Open3D ICP front end."""

    method: Literal["point_to_point", "generalized"] = Field(
        "point_to_point",
        description="Open3D's registration to use; generalized takes three times as long and drifts no less.",
    )
    reach_m: float = Field(1.0, gt=0.0, description="Longest distance between corresponding points [m].")
    keyframes: int = Field(20, ge=1, description="Number of scans that the map holds.")
    keyframe_m: float = Field(2.0, ge=0.0, description="A scan joins the map after this much travel [m].")
    keyframe_rad: float = Field(0.1, ge=0.0, description="A scan also joins the map after this much turning [rad].")
    first_reach: float = expert(
        3.0,
        ge=1.0,
        description="Reach of the first registration of a scan, in units of reach_m, which is that of the second.",
    )
    scan_voxel: float = expert(0.5, gt=0.0, description="Side of a scan's voxels, as a share of the map's.")
    iterations: int = expert(30, ge=1, description="Most iterations of one registration.")
    loss: float = expert(
        1.0, gt=0.0, description="Squared residual at which generalized ICP gives a pair a quarter of the weight [m^2]."
    )


class OdometryConfig(BaseModel):
    """Settings of the odometry front end: the errors of an odometry that does not state its own."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    sigma_travel: float = Field(
        0.05,
        ge=0.0,
        description="Standard deviation of travel, as a share of it. The graph estimates it better where it can.",
    )
    sigma_rest_m: float = Field(0.01, gt=0.0, description="Standard deviation of the position over a scan at rest [m].")
    sigma_yaw_rate: float = Field(0.02, gt=0.0, description="Standard deviation of the yaw rate [rad/s].")
    sigma_mount_m: float = Field(
        0.05,
        gt=0.0,
        description="Standard deviation of the radar's place on the vehicle along each axis, where it is stated [m]. The "
        "point that wheels move without slip lies between the rear wheels, and a tape measure finds it no better.",
    )
    sigma_mount_rad: float = Field(
        0.01,
        gt=0.0,
        description="Standard deviation of the yaw at which the radar is mounted, where it is stated [rad]: MulRan's "
        "calibration differs from straight ahead by as much.",
    )
    mount_common_m: float = expert(
        0.03,
        ge=0.0,
        description="Standard deviation of what psi itself gets wrong in all turns alike, as a place of the radar [m]: "
        "0.015 to 0.028 was found in simulated streets. An estimate states it beside what scatters from motion to motion.",
    )
    mount_common_rad: float = expert(
        0.0005, ge=0.0, description="The same of the yaw [rad]: 0.0001 to 0.0005 was found in these streets."
    )
    mount_known_m: float = expert(
        0.5,
        gt=0.0,
        description="The radar's place on the vehicle is stated as an estimate if its standard deviation along each axis is "
        "smaller than this [m]; without turns it is not.",
    )
    mount_known_rad: float = expert(
        0.02,
        gt=0.0,
        description="The same of the yaw at which the radar is mounted [rad], for which driving straight suffices.",
    )
