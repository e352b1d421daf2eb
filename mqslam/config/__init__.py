"""All settings as one tree; every setting has its unit and reason where it is defined."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Collection
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, model_validator

from mqslam.audit.verdict import VerdictConfig
from mqslam.config.audit import AuditConfig
from mqslam.config.settings_file import parsed
from mqslam.errors import ConfigError


class SensorConfig(BaseModel):
    """What a recording does not say about its radar."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    range_resolution_m: float | None = Field(
        None, gt=0.0, description="length of a range bin [m]; null takes the recording's or its format's"
    )
    doppler_beta: float | None = Field(
        None,
        description="range shift per closing speed [s], signed by the chirp, about 0.049 on the Oxford unit; "
        "null measures it by psi",
    )
    clockwise: bool | None = Field(
        None,
        description="whether the radar turns clockwise, seen from above, where azimuths carry no angles; null takes the "
        "format's default, clockwise in all of them",
    )
    stamp: Literal["start", "end"] | None = Field(
        None,
        description="which instant of a revolution its only stamp is, where azimuths carry no stamps; null takes the "
        "format's default: end in mulran, radiate and images on a bag's /radar/polar (MulRan's player), start in other bags",
    )


class DetectorConfig(BaseModel):
    """Settings of the detector."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    threshold: float = Field(40.0, ge=0.0, le=255.0, description="smoothed power that is surely a target [0..255]")
    contrast: float = Field(
        7.0,
        gt=0.0,
        description="where noise is low, so many of its spreads above its median are enough: finer bins are smoothed more",
    )
    strongest: int = Field(12, ge=1, description="peaks kept per azimuth")
    smoothing_m: float = Field(0.2, ge=0.0, description="half width of the window that smooths power along range [m]")
    min_range_m: float = Field(2.5, ge=0.0, description="nearer returns are the vehicle itself [m]")
    max_range_m: float = Field(150.0, gt=0.0, description="farther returns are too blurred across the beam to help [m]")
    join_m: float = Field(0.6, ge=0.0, description="peaks of neighbouring azimuths this close in range are one target [m]")
    saturation: float = Field(
        12.0, gt=0.0, description="an azimuth whose median power exceeds the revolution's by this much is saturated [0..255]"
    )
    ring_share: float = Field(
        0.3,
        gt=0.0,
        le=1.0,
        description="a range at which this share of all azimuths peaks at once, and twice as many as around it, is a ring",
    )

    @model_validator(mode="after")
    def _check_ranges(self) -> DetectorConfig:
        if self.max_range_m <= self.min_range_m:
            raise ValueError(f"max_range_m ({self.max_range_m}) must be larger than min_range_m ({self.min_range_m})")
        return self


class PsiConfig(BaseModel):
    """Parameters of the published score, named as in the paper, which gives no values: these are ours."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    s: float = Field(2.0, gt=0.0, description="radius of the neighbourhood [m]")
    alpha_s: float = Field(0.0, ge=0.0, description="distance at which the spatial kernel peaks [m]")
    beta_s: float = Field(1.0, gt=0.0, description="width of the spatial kernel [m]")
    alpha_t: float | None = Field(
        None, ge=0.0, description="time apart at which the temporal kernel peaks [s]; null takes one revolution"
    )
    beta_t: float = Field(0.06, gt=0.0, description="width of the temporal kernel [s]")
    tau: float = Field(0.5, gt=0.0, description="width of the Lorentzian [m]")
    xi: float = Field(0.02, gt=0.0, lt=1.0, description="pairs with a smaller kappa take no part")
    temporal: Literal["plateau", "gaussian"] = Field(
        "plateau", description="plateau: the time term is 1 from alpha_t on; gaussian: as printed in (8)"
    )
    numerator: Literal["tau/2", "tau"] = Field("tau/2", description="numerator of L: (9) or Algorithm 1")
    factor: Literal["distance", "kappa"] = Field("distance", description="S = L s_ij (10) or L kappa_ij (Algorithm 1)")
    unmatched: float = Field(
        1.0, ge=0.0, description="charge of a point without a neighbour, in units of the dearest pair; 0 is as printed"
    )

    @property
    def charge(self) -> float:
        """What one unmatched point costs."""
        return self.unmatched * (2.0 * self.s / (math.pi * self.tau)) ** 2


@dataclass(frozen=True, slots=True)
class Scale:
    """How wide the score looks.

    Args:
        s: neighbours farther than this take no part [m].
        beta_s: width of the spatial kernel [m].
        c: offset, in standard deviations, at which a point's weight has fallen to a quarter.
    """

    s: float
    beta_s: float
    c: float


class EstimatorConfig(BaseModel):
    """Settings of the score that the estimator minimises, and of the way it does so."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    s: float = Field(0.6, gt=0.0, description="neighbours farther than this take no part, at the end of annealing [m]")
    s_start: float = Field(2.5, gt=0.0, description="the same at the start of annealing [m]")
    beta_s: float = Field(0.25, gt=0.0, description="width of the spatial kernel at the end [m]")
    beta_s_start: float = Field(1.25, gt=0.0, description="the same at the start [m]")
    c: float = Field(1.5, gt=0.0, description="offset that quarters a point's weight at the end [standard deviations]")
    c_start: float = Field(5.0, gt=0.0, description="the same at the start [standard deviations]")
    shrink: float = Field(0.6, gt=0.0, lt=1.0, description="factor on the widths from step to step")
    steps: int = Field(12, ge=1, description="most Newton steps")
    beta_t: float = Field(0.06, gt=0.0, description="fade of pairs less than one turn apart [s]")
    xi: float = Field(0.02, gt=0.0, lt=1.0, description="least kappa of a selected neighbour")
    blur_m: float = Field(0.15, ge=0.0, description="scatter of one object's returns between views, isotropic [m]")
    sigma_range_m: float = Field(0.15, gt=0.0, description="error of a return along the ray [m]")
    sigma_azimuth: float = Field(0.008, gt=0.0, description="error of a return across the ray [rad]")
    stabiliser: float = Field(
        0.15, ge=0.0, description="share of Gauss-Newton curvature added to the re-selecting curvature, to keep steps safe"
    )
    correlation: float = Field(
        10.0, ge=1.0, description="returns that repeat one another: information is divided by this against a prior"
    )

    def scale(self, step: int) -> Scale:
        """Widths at one step of the annealing."""
        f = self.shrink**step
        return Scale(max(self.s, self.s_start * f), max(self.beta_s, self.beta_s_start * f), max(self.c, self.c_start * f))

    @property
    def final(self) -> Scale:
        """Widths at the end of the annealing."""
        return Scale(self.s, self.beta_s, self.c)


class TrackerConfig(BaseModel):
    """Settings of odometry by psi over a running map."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    keyframe_m: float = Field(
        8.0, gt=0.0, description="a revolution joins the map after this much travel [m], sooner while the map is young"
    )
    keyframe_rad: float = Field(0.1, gt=0.0, description="or after this much turning [rad]")
    keyframes: int = Field(40, ge=1, description="revolutions the map holds")
    sigma_position_m: float = Field(0.01, gt=0.0, description="process noise of the start pose per revolution [m]")
    sigma_yaw: float = Field(0.0003, gt=0.0, description="process noise of the start yaw per revolution [rad]")
    sigma_vx: float = Field(0.6, gt=0.0, description="jump of forward speed per 0.25 s besides acceleration [m/s]")
    sigma_vy: float = Field(0.15, gt=0.0, description="change of sideways speed per 0.25 s [m/s]")
    sigma_omega: float = Field(0.08, gt=0.0, description="jump of yaw rate per 0.25 s besides acceleration [rad/s]")
    sigma_ax: float = Field(4.0, gt=0.0, description="change of forward acceleration per 0.25 s [m/s^2]")
    sigma_alpha: float = Field(0.6, gt=0.0, description="change of yaw acceleration per 0.25 s [rad/s^2]")
    persistence: float = Field(0.9, ge=0.0, le=1.0, description="part of an acceleration that is left after 0.25 s")
    speed_min: float = Field(-5.0, description="slowest speed of the cold start's search [m/s]")
    speed_max: float = Field(40.0, description="fastest speed of the cold start's search [m/s]")
    omega_max: float = Field(1.0, gt=0.0, description="fastest turn of the cold start's search [rad/s]")
    sigma_scale: float = Field(
        0.01,
        ge=0.0,
        description="standard deviation of a distance across a gap, per distance: what is published of the length of one "
        "radar's range bins differs by 1.4 %, and a Doppler shift that is ignored costs as much",
    )
    lost_share: float = Field(
        0.5, gt=0.0, lt=1.0, description="a matched share below this part of the usual one means the track may be lost"
    )

    @model_validator(mode="after")
    def _check_speeds(self) -> TrackerConfig:
        if self.speed_max <= self.speed_min:
            raise ValueError(f"speed_max ({self.speed_max}) must be larger than speed_min ({self.speed_min})")
        return self


class KissIcpConfig(BaseModel):
    """Settings of the KISS-ICP front end."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    voxel_size_m: float = Field(1.0, gt=0.0, description="voxel of its map [m]; 0.5 to 2.0 measure alike on radar returns")
    max_range_m: float = Field(100.0, gt=0.0, description="farther returns are dropped [m]")
    deskew: bool = Field(True, description="whether each return is moved by the last motion")
    config_file: Path | None = Field(
        None, description="YAML file of KISS-ICP's own, which takes the place of the settings above; null for those"
    )


class Open3dIcpConfig(BaseModel):
    """Settings of the Open3D ICP front end."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    method: Literal["point_to_point", "generalized"] = Field(
        "point_to_point", description="registration of Open3D's; generalized takes three times as long and drifts no less"
    )
    voxel_size_m: float = Field(1.0, gt=0.0, description="voxel of its map [m]; a scan's is half of it")
    max_range_m: float = Field(100.0, gt=0.0, description="farther returns are dropped [m]")
    reach_m: float = Field(1.0, gt=0.0, description="farthest correspondence [m], three times that for a first pass")
    keyframes: int = Field(20, ge=1, description="revolutions the map holds")
    keyframe_m: float = Field(2.0, ge=0.0, description="a revolution joins the map after this much travel [m]")
    keyframe_rad: float = Field(0.1, ge=0.0, description="or after this much turning [rad]")


class GraphConfig(BaseModel):
    """Settings of the pose graph."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    floor_m: float = Field(0.01, gt=0.0, description="least standard deviation of an edge's position [m]")
    floor_rad: float = Field(0.0003, gt=0.0, description="least standard deviation of an edge's yaw [rad]")
    cancelling: float = Field(
        40.0,
        ge=1.0,
        description="both ends of an edge are matched to one map, so errors of successive edges cancel: in the graph an "
        "edge's covariance is divided by this, and the floor says how edges drift together",
    )
    huber: float = Field(1.345, gt=0.0, description="residual beyond which an edge's pull grows only linearly [sigma]")
    odometry_span_s: float = Field(
        10.0, gt=0.0, description="odometry noise is what it disagrees with psi over this span [s]"
    )


class LoopConfig(BaseModel):
    """Settings of loop closures."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    enabled: bool = Field(True, description="whether loops are looked for")
    rounds: int = Field(2, ge=1, description="searches; each starts from the trajectory the one before has mended")
    passes: int = Field(1, ge=1, description="earlier passes a revolution is tied to, the nearest first")
    spacing_m: float = Field(5.0, gt=0.0, description="path between revolutions that are tried and rendered [m]")
    least_path_m: float = Field(60.0, gt=0.0, description="shorter ways round are odometry, not loops [m]")
    reach_m: float = Field(12.0, gt=0.0, description="two passes this far apart still see the same things [m]")
    drift: float = Field(0.005, ge=0.0, description="drift of the trajectory to reckon with, per path [m/m]")
    drift_rad: float = Field(3e-5, ge=0.0, description="the same for yaw [rad/m]")
    search_m: float = Field(3.0, gt=0.0, description="least half width of the search [m]")
    search_rad: float = Field(0.03, gt=0.0, description="the same for yaw [rad]")
    gate_m: float = Field(40.0, gt=0.0, description="largest half width of the search [m]")
    gate_rad: float = Field(0.15, gt=0.0, description="the same for yaw [rad]")
    submap_m: float = Field(15.0, gt=0.0, description="path around a revolution that its submap holds, either way [m]")
    fewest: int = Field(300, ge=1, description="least returns of a submap")
    matched: float = Field(0.45, gt=0.0, lt=1.0, description="least share of returns that lie on the other pass")
    rival: float = Field(1.1, ge=1.0, description="the next best pose must score worse by this factor")
    sure_m: float = Field(0.3, gt=0.0, description="largest standard deviation of a loop's position [m]")
    kept: float = Field(1.1, ge=1.0, description="a loop stays if psi under the final poses is within this of its own")
    floor_m: float = Field(0.05, gt=0.0, description="standard deviation of a loop besides its own: submaps bend [m]")
    floor_rad: float = Field(0.0015, gt=0.0, description="the same for yaw [rad]")
    cauchy: float = Field(3.0, gt=0.0, description="residual at which a loop's pull begins to fade [sigma]")


class MapConfig(BaseModel):
    """Settings of the rendered map."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    cell_m: float = Field(0.2, gt=0.0, description="cell of the nav2 map [m]")
    travel_m: float = Field(0.1, ge=0.0, description="a revolution nearer to the last rendered one adds nothing [m]")
    travel_rad: float = Field(0.01, ge=0.0, description="unless it has turned by more than this [rad]")


class Config(BaseModel):
    """Every setting of a run."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    sensor: SensorConfig = SensorConfig()
    detector: DetectorConfig = DetectorConfig()
    psi: PsiConfig = PsiConfig()
    estimator: EstimatorConfig = EstimatorConfig()
    tracker: TrackerConfig = TrackerConfig()
    kiss_icp: KissIcpConfig = KissIcpConfig()
    open3d_icp: Open3dIcpConfig = Open3dIcpConfig()
    graph: GraphConfig = GraphConfig()
    loops: LoopConfig = LoopConfig()
    map: MapConfig = MapConfig()
    audit: AuditConfig = AuditConfig()
    verdict: VerdictConfig = VerdictConfig()


def load_config(name: str | Path | None = None) -> Config:
    """The default settings, changed by a YAML file or by one that ships with mqslam (`oxford`, `default`).

    Raises:
        ConfigError: no such file, not YAML, or a setting that is unknown or out of range.
    """
    if name is None:
        return Config()
    path = Path(name)
    shipped = resources.files("mqslam.configs") / f"{name}.yaml"
    try:
        if path.is_file():
            content = path.read_bytes()
        elif shipped.is_file():
            content = shipped.read_bytes()
        else:
            raise ConfigError(f"{name}: no such configuration; give a YAML file or one of {', '.join(shipped_names())}")
    except (OSError, ValueError) as error:
        raise ConfigError(f"{name}: cannot be read ({error})") from error
    return parsed(Config, name, content)


def shipped_names() -> list[str]:
    """Configurations that come with mqslam."""
    folder = resources.files("mqslam.configs")
    return sorted(entry.name[:-5] for entry in folder.iterdir() if entry.name.endswith(".yaml"))


def dump_yaml(config: Config, leave_out: Collection[str] = ()) -> str:
    """Every setting, but for some sections, as YAML that `load_config` reads back."""
    text: str = yaml.safe_dump(config.model_dump(mode="json", exclude=set(leave_out)), sort_keys=False)
    return text


def explained_yaml(config: Config) -> str:
    """The same with the reason and unit of every setting above it."""
    lines = []
    for name, section in config:
        lines += [f"# {(type(section).__doc__ or '').splitlines()[0]}", f"{name}:"]
        for key, field in type(section).model_fields.items():
            value = yaml.safe_dump({key: section.model_dump(mode="json")[key]}).rstrip()
            lines += [*(f"  # {line}" for line in textwrap.wrap(field.description or "", 110)), f"  {value}"]
        lines.append("")
    return "\n".join(lines)


def changes(before: Config, after: Config) -> list[tuple[str, Any, Any]]:
    """Settings that differ: name, value before and value after, as JSON has them."""
    found = []
    for name, section in before:
        old, new = section.model_dump(mode="json"), getattr(after, name).model_dump(mode="json")
        found += [(f"{name}.{key}", old[key], new[key]) for key in old if old[key] != new[key]]
    return found
