"""All settings as one tree; each setting is defined with its unit and its reason."""

from __future__ import annotations

import math
import textwrap
from importlib import resources
from pathlib import Path
from typing import Any, Final, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from mqslam.config.yaml_file import parse_yaml
from mqslam.errors import ConfigError, suggest, untrusted

# Marks a setting that only an expert would touch; it is shown on request, or where a file changes it.
EXPERT: Final[dict[str, Any]] = {"expert": True}


class Section(BaseModel):
    """Settings that belong together: others than these are refused, and none changes."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class ReadingConfig(Section):
    """How a recording is understood where it does not say so itself."""

    lidar_fov_deg: float | None = Field(
        None,
        gt=0.0,
        le=360.0,
        description="Angle [degrees] that the readings of a CARMEN log's FLASER lines sweep, centred ahead. null takes what "
        "the log's parameters state, else 180 degrees where there are 180, 181, 360 or 361 readings, as of SICK's lidars.",
    )


USUAL_READING = ReadingConfig()
"""The settings where nobody states others."""


class SensorConfig(Section):
    """Properties of the radar that its recording does not state."""

    range_resolution_m: float | None = Field(
        None,
        gt=0.0,
        description="Length of a range bin [m]. null takes what the recording states, else what is usual for its format.",
    )
    doppler_beta: float | None = Field(
        None,
        ge=-1.0,
        le=1.0,
        description="Range shift per closing speed [s], signed by the chirp, about 0.049 on the Oxford unit. Known radars "
        "are within 0.1 s: a value beyond 1 s is a mistake of the unit. Null measures it by psi.",
    )
    clockwise: bool | None = Field(
        None,
        description="Whether the radar turns clockwise, seen from above. false mirrors what a radar sees that is mounted "
        "upside down. null takes what azimuths say, or clockwise where they carry no angles.",
    )
    stamp: Literal["start", "end"] | None = Field(
        None,
        description="Instant of a turn at which a polar scan is stamped. It matters only where azimuths carry no stamps. "
        "null takes the format's default: end in mulran, radiate and images on a bag's /radar/polar (MulRan's player) "
        "or /radar_data/b_scan_image (Navtech's driver), start in other bags.",
    )

    encoder_size: int | None = Field(
        None,
        ge=2,
        le=65536,
        description="Ticks of the encoder in a turn, where azimuths carry encoder values. null takes what the recording "
        "states, else what Navtech's radars have: 5600, or 16000 in messages of its driver that show it.",
    )
    radar_topic: str | None = Field(
        None, description="Topic of a bag's polar scans. null chooses it by type and name, or by the shape of its images."
    )
    odometry_topic: str | None = Field(None, description="Topic of a bag's odometry. null chooses it by type and name.")
    truth_topic: str | None = Field(None, description="Topic of a bag's ground truth. null chooses it by type and name.")


class DetectorConfig(Section):
    """Settings of the detector."""

    threshold: float = Field(
        40.0, ge=0.0, le=255.0, description="Smoothed power above which a peak is a target in any data [0..255]."
    )
    contrast: float = Field(
        7.0,
        gt=0.0,
        description="Detection threshold in low-noise data, above the median power and in units of the noise spread "
        "(median minus 10th percentile). It applies where it is below `threshold`.",
    )
    most_returns: int = Field(
        1000,
        ge=1,
        description="Number of returns that are kept per scan, the strongest. All that stand out of the noise by "
        "`contrast` are kept, however many they are.",
    )
    min_range_m: float = Field(2.5, ge=0.0, description="Nearer returns are of the vehicle itself and are dropped [m].")
    max_range_m: float = Field(
        150.0, gt=0.0, description="Farther returns are dropped [m]: they are too blurred across the beam to help."
    )

    @model_validator(mode="after")
    def _check_ranges(self) -> DetectorConfig:
        if self.max_range_m <= self.min_range_m:
            raise ValueError(f"max_range_m ({self.max_range_m}) must be larger than min_range_m ({self.min_range_m})")
        return self


class PsiConfig(Section):
    """Parameters of the published score, named as in the paper, which gives no values: these are ours."""

    s: float = Field(2.0, gt=0.0, description="Radius of a point's neighbourhood [m].")
    beta_s: float = Field(1.0, gt=0.0, description="Width of the spatial kernel [m].")
    alpha_t: float | None = Field(
        None,
        ge=0.0,
        description="Difference in time at which the temporal kernel peaks [s]; null takes one turn of the radar.",
    )
    beta_t: float = Field(0.06, gt=0.0, description="Width of the temporal kernel [s].")
    tau: float = Field(0.5, gt=0.0, description="Width of the Lorentzian [m].")
    temporal: Literal["plateau", "gaussian"] = Field(
        "plateau", description="Temporal kernel: plateau is 1 from alpha_t on; gaussian is as printed in (8)."
    )
    numerator: Literal["tau/2", "tau"] = Field(
        "tau/2", description="Numerator of the Lorentzian: tau/2 as in (9), or tau as in Algorithm 1."
    )
    factor: Literal["distance", "kappa"] = Field(
        "distance", description="Factor on the Lorentzian: distance is s_ij as in (10), kappa is kappa_ij as in Algorithm 1."
    )
    unmatched: float = Field(
        1.0,
        ge=0.0,
        description="Charge of a point without a neighbour, in units of the most that one pair can cost; 0 is as printed.",
    )

    @property
    def charge(self) -> float:
        """Cost of one unmatched point."""
        return self.unmatched * (2.0 * self.s / (math.pi * self.tau)) ** 2


class EstimatorConfig(Section):
    """Settings of the score that the estimator minimises, and of the way it does so."""

    s: float = Field(0.6, gt=0.0, description="Distance beyond which neighbours take no part, at the end of annealing [m].")
    s_start: float = Field(
        2.5, gt=0.0, description="Distance beyond which neighbours take no part, at the start of annealing [m]."
    )
    beta_s: float = Field(0.25, gt=0.0, description="Width of the spatial kernel at the end of annealing [m].")
    beta_s_start: float = Field(1.25, gt=0.0, description="Width of the spatial kernel at the start of annealing [m].")
    blur_m: float = Field(
        0.15,
        ge=0.0,
        description="Standard deviation by which the returns of one object scatter between views, in any direction [m].",
    )
    sigma_range_m: float = Field(0.15, gt=0.0, description="Standard deviation of a return along the ray [m].")
    sigma_azimuth: float = Field(0.008, gt=0.0, description="Standard deviation of a return across the ray [rad].")
    cluster_m: float = Field(
        2.0,
        gt=0.0,
        json_schema_extra=EXPERT,
        description="Side of the cells [m] within which returns count as one object in the covariance of a minimum, "
        "because their errors are common.",
    )


# Number of scans before a segment that its track begins with, so that its own scans meet a map that has grown. Where there
# are not as many in a row that hold enough returns, no segment begins.
WARM_UP_SCANS = 36


class TrackerConfig(Section):
    """Settings of odometry by psi over a running map."""

    sigma_omega: float = Field(
        0.03, gt=0.0, description="Change of yaw rate per 0.25 s that yaw acceleration does not explain [rad/s]."
    )
    sigma_alpha: float = Field(0.2, gt=0.0, description="Change of yaw acceleration per 0.25 s [rad/s^2].")
    speed_max: float = Field(40.0, gt=0.0, description="Fastest speed that the cold start tries [m/s].")

    stamp_sigma_s: float | None = Field(
        None,
        ge=0.0,
        description="Standard deviation of a scan's stamp [s]. null takes what the reader has found where scans are stamped "
        "as they arrive, and 0 where stamps are the radar's own.",
    )

    segment_scans: int = Field(
        0,
        ge=0,
        description="Number of scans of a segment: segments are tracked on their own, so that several workers can do so at "
        "a time. 300 is a good one for long recordings. With 0 a recording is one segment. Of two drives of a thousand "
        "scans, one drifted by 3 % less in segments and one by 30 % more, in a bend in which either track errs.",
    )

    @field_validator("segment_scans")
    @classmethod
    def _check_segments(cls, segment_scans: int) -> int:
        if 0 < segment_scans < 2 * WARM_UP_SCANS:
            raise ValueError(f"must be 0 or at least {2 * WARM_UP_SCANS}, twice the scans that a track warms up on")
        return segment_scans


class ScanMatchingConfig(Section):
    """Settings that the front ends share which match scan after scan to a map of their own."""

    voxel_size_m: float = Field(
        1.0, gt=0.0, description="Side of the voxels of its map [m]. Values of 0.5 to 2.0 measure alike on radar returns."
    )
    max_range_m: float = Field(100.0, gt=0.0, description="Farther returns are dropped [m].")


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


class OdometryConfig(Section):
    """Settings of the odometry front end: the errors of an odometry that does not state its own."""

    sigma_travel: float = Field(
        0.05,
        ge=0.0,
        description="Standard deviation of travel, as a share of it. The graph estimates it better where it can.",
    )
    sigma_yaw_rate: float = Field(0.02, gt=0.0, description="Standard deviation of the yaw rate [rad/s].")


class LoopConfig(Section):
    """Settings of loop closures."""

    enabled: bool = Field(True, description="Whether loops are looked for.")


class RefinementConfig(Section):
    """Settings of the refinement of a trajectory, once its loops are closed."""

    rounds: int = Field(
        0,
        ge=0,
        description="Most rounds in which every scan is measured against the other passes around it; each starts from the "
        "trajectory that the round before has refined. 0 leaves the trajectory as the loops have made it: passes lie "
        "better on each other after two rounds, but the trajectory as a whole was not always nearer to the truth.",
    )


class MapConfig(Section):
    """Settings of the rendered map."""

    cell_m: float = Field(0.2, gt=0.0, description="Side of a cell of the nav2 map [m].")


class MergeConfig(Section):
    """How several recordings become one map."""

    changes: bool = Field(True, description="Whether changes between the recordings are looked for.")


class AuditConfig(Section):
    """How a map is judged."""

    # an audited trajectory, which anyone may have made, may drift more than our own does before loops are closed
    spacing_m: float = Field(
        10.0, gt=0.0, description="Path [m] between the scans for which an earlier pass of the same place is looked for."
    )
    least_path_m: float = Field(
        60.0, gt=0.0, description="Two scans with less path between them [m] are not two passes: odometry ties them already."
    )
    reach_m: float = Field(12.0, gt=0.0, description="Distance [m] at which two passes still see the same things.")
    search_m: float = Field(3.0, gt=0.0, description="Least half width of the search for the later pass's position [m].")
    search_rad: float = Field(0.05, gt=0.0, description="Least half width of the search in yaw [rad].")
    gate_m: float = Field(40.0, gt=0.0, description="Largest half width of the search for the later pass's position [m].")
    gate_rad: float = Field(0.3, gt=0.0, description="Largest half width of the search in yaw [rad].")
    submap_m: float = Field(
        15.0,
        gt=0.0,
        description="The submap of the earlier pass holds the returns within this path [m] to either side of a scan.",
    )
    fewest: int = Field(300, ge=1, description="A submap with fewer returns than this is not compared.")
    matched: float = Field(
        0.45, gt=0.0, lt=1.0, description="Least share of the later pass's returns that must lie on the earlier pass."
    )
    bend_m: float = Field(
        0.05, ge=0.0, description="A window whose best correction moves its points by less than this [m] is not torn."
    )
    jump_m: float = Field(0.1, ge=0.0, description="A step that moves the points after it by less than this [m] is no jump.")
    radius_m: float = Field(
        1.0,
        gt=0.0,
        description="Radius [m] of the neighbourhoods of the entropies and plane variance; cells of the evidence grid are "
        "half as wide.",
    )
    submap_spacing_m: float = Field(5.0, gt=0.0, description="Path [m] between the scans that a submap is rendered from.")
    torn_m: float = Field(0.5, gt=0.0, description="Two passes are torn if they are farther apart than this [m].")
    torn_rad: float = Field(
        0.0175, gt=0.0, description="Two passes are torn, too, if one is turned against the other by more than this [rad]."
    )
    drift: float = Field(0.02, ge=0.0, description="Drift of the trajectory to reckon with, per length of path [m/m].")
    drift_rad: float = Field(1e-4, ge=0.0, description="Drift of the yaw to reckon with, per length of path [rad/m].")
    scan_matched: float = Field(
        0.6,
        gt=0.0,
        le=1.0,
        json_schema_extra=EXPERT,
        description="Scans beside each other must match at least this share of what two passes must (audit.matched): single "
        "scans, each with noise of its own, share fewer points than maps of many scans do.",
    )


class VerdictConfig(Section):
    """How often a verdict may be wrong about a good map, and how large a fault matters."""

    false_alarms: float = Field(
        0.01,
        gt=0.0,
        lt=0.5,
        description="Probability with which all tests that give p-values together call a good map bad.",
    )
    tolerance_m: float | None = Field(
        None,
        gt=0.0,
        description="Two passes may be this far apart [m]; all other tolerances of the verdict (in section audit) follow in "
        "proportion. null takes audit.torn_m, and leaves the others as they are.",
    )


class Config(Section):
    """All settings of a run."""

    reading: ReadingConfig = ReadingConfig()
    sensor: SensorConfig = SensorConfig()
    detector: DetectorConfig = DetectorConfig()
    psi: PsiConfig = PsiConfig()
    estimator: EstimatorConfig = EstimatorConfig()
    tracker: TrackerConfig = TrackerConfig()
    kiss_icp: KissIcpConfig = KissIcpConfig()
    open3d_icp: Open3dIcpConfig = Open3dIcpConfig()
    odometry: OdometryConfig = OdometryConfig()
    loops: LoopConfig = LoopConfig()
    refinement: RefinementConfig = RefinementConfig()
    merge: MergeConfig = MergeConfig()
    map: MapConfig = MapConfig()
    audit: AuditConfig = AuditConfig()
    verdict: VerdictConfig = VerdictConfig()


def load_config(name: str | Path | None = None) -> Config:
    """Returns the default settings, changed by a YAML file or by one that ships with mqslam.

    Args:
        name: path of a YAML file, or the name of one that ships, such as `oxford`; None takes the defaults.

    Raises:
        ConfigError: the file does not exist or is not YAML, or a setting is unknown or out of range.
    """
    if name is None:
        return Config()
    path = Path(name)
    shipped = resources.files("mqslam.configs") / f"{name}.yaml"
    try:
        if path.is_file():
            content: str | bytes = untrusted.read_document(path, untrusted.YAML_BYTES)
        elif shipped.is_file():
            content = shipped.read_bytes()
        else:
            raise ConfigError(f"{name}: no such configuration and no such file; {suggest(path.stem, list_shipped())}")
    except UnicodeDecodeError as error:
        raise ConfigError(f"{name}: is not a readable YAML file ({error})") from error
    except (OSError, ValueError) as error:
        raise ConfigError(f"{name}: cannot be read ({error})") from error
    return parse_yaml(Config, name, content)


def list_shipped() -> list[str]:
    """Returns the names of the configurations that ship with mqslam."""
    folder = resources.files("mqslam.configs")
    return sorted(entry.name[:-5] for entry in folder.iterdir() if entry.name.endswith(".yaml"))


def set_doppler_beta(config: Config, doppler_beta: float) -> Config:
    """Returns the settings with the Doppler shift [s] that was used, as the config.yaml of a result states them."""
    return set_sensor(config, doppler_beta=doppler_beta)


def set_sensor(config: Config, **changed: float | str | None) -> Config:
    """Returns the settings with others of the section `sensor`, which are taken as they are."""
    return config.model_copy(update={"sensor": config.sensor.model_copy(update=changed)})


def set_false_alarms(config: Config, rate: float) -> Config:
    """Returns the settings with another rate of false alarms per recording."""
    return config.model_copy(update={"verdict": config.verdict.model_copy(update={"false_alarms": rate})})


def set_tolerance(config: Config, metres: float | None) -> Config:
    """Returns the settings with another tolerance of the verdict [m]; the same settings for None.

    Raises:
        ConfigError: the tolerance is not positive and finite.
    """
    if metres is None:
        return config
    if not 0.0 < metres < math.inf:
        raise ConfigError(f"a tolerance of {metres:g} m is not a length above 0; give one in metres, such as 0.3")
    return config.model_copy(update={"verdict": config.verdict.model_copy(update={"tolerance_m": metres})})


def dump_yaml(config: Config) -> str:
    """Returns every setting as YAML that `load_config` reads back."""
    text: str = yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False)
    return text


def explain_yaml(config: Config, *, everything: bool = True) -> str:
    """Returns the settings as YAML, each under a comment with its reason and unit.

    Args:
        config: the settings.
        everything: whether settings that only an expert would touch are listed even if they have their default.
    """
    lines = []
    for name, section in config:
        values = section.model_dump(mode="json")
        defaults = type(section)().model_dump(mode="json")
        shown = {
            key: field.description or ""
            for key, field in type(section).model_fields.items()
            if everything or field.json_schema_extra != EXPERT or values[key] != defaults[key]
        }
        if not shown:
            continue
        lines += [f"# {(type(section).__doc__ or '').splitlines()[0]}", f"{name}:"]
        for key, description in shown.items():
            value = yaml.safe_dump({key: values[key]}).rstrip()
            lines += [*(f"  # {line}" for line in textwrap.wrap(description, 110)), f"  {value}"]
        lines.append("")
    return "\n".join(lines)


def list_changes(before: Config, after: Config) -> list[tuple[str, Any, Any]]:
    """Returns the settings that differ, each as its name, the value before and the value after, as JSON has them."""
    differing = []
    for name, section in before:
        old, new = section.model_dump(mode="json"), getattr(after, name).model_dump(mode="json")
        differing += [(f"{name}.{key}", old[key], new[key]) for key in old if old[key] != new[key]]
    return differing
