"""Defines all settings as one tree, each with its unit and a description, and reads and writes them as YAML."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Mapping
from importlib import resources
from numbers import Real
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias

import yaml
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from mqslam.config.yaml_file import check_tree, parse_tree
from mqslam.errors import ConfigError, require_type, suggest, untrusted

# Marks a setting that only an expert would change; such a setting is shown only on request, or if a file changes it.
EXPERT: Final[dict[str, Any]] = {"expert": True}


class Section(BaseModel):
    """A group of settings: unknown names and numbers that are not finite are refused, and values cannot be changed."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class ReadingConfig(Section):
    """Settings for reading a recording, used where the recording does not state these values itself."""

    lidar_fov_deg: float | None = Field(
        None,
        gt=0.0,
        le=360.0,
        description="Angle from the first to the last reading of a FLASER line in a CARMEN log, centred straight ahead "
        "[degrees]. null takes the angle in the log's parameters, else 180 degrees if there are 180, 181, 360 or 361 "
        "readings, as from SICK's lidars.",
    )


USUAL_READING = ReadingConfig()
"""The default settings for reading recordings."""


class SensorConfig(Section):
    """Properties of the radar that its recording does not state."""

    range_resolution_m: float | None = Field(
        None,
        gt=0.0,
        description="Length of a range bin [m]. null takes what the recording states, else the usual length of its format.",
    )
    range_offset_m: float | None = Field(
        None,
        ge=-10.0,
        le=10.0,
        description="True range of an object at rest minus the range of its bin's centre [m]: about -0.3 on Navtech's "
        "radars. null takes what the recording states, else the usual offset of its format: 0 for all but Boreas.",
    )
    doppler_beta: float | None = Field(
        None,
        ge=-1.0,
        le=1.0,
        description="Range shift per closing speed [s]; its sign depends on the chirp. It is about 0.049 on Oxford's radar, "
        "and within 0.1 s on all known radars: a value beyond 1 s is in another unit. null measures it by psi.",
    )
    clockwise: bool | None = Field(
        None,
        description="Whether the radar turns clockwise, seen from above. false mirrors the scans of a radar that is mounted "
        "upside down. null takes the direction of the azimuths' angles, or clockwise if azimuths carry no angles.",
    )
    stamp: Literal["start", "end"] | None = Field(
        None,
        description="Instant of a revolution at which a polar scan is stamped. It matters only if azimuths have no stamps. "
        "null takes the format's default: end in mulran, radiate and images on a bag's /radar/polar (MulRan's player) "
        "or /radar_data/b_scan_image (Navtech's driver), start in other bags.",
    )

    encoder_size: int | None = Field(
        None,
        ge=2,
        le=65536,
        description="Ticks of the encoder per revolution, if azimuths carry encoder values. null takes the number that "
        "the recording states, else the number of Navtech's radars: 5600, or 16000 if messages of Navtech's driver show it.",
    )
    radar_topic: str | None = Field(
        None, description="Topic of a bag's polar scans. null chooses it by type and name, or by the shape of its images."
    )
    odometry_topic: str | None = Field(None, description="Topic of a bag's odometry. null chooses it by type and name.")
    truth_topic: str | None = Field(None, description="Topic of a bag's ground truth. null chooses it by type and name.")


class DetectorConfig(Section):
    """Settings of the detector, which finds the returns in a polar scan."""

    threshold: float = Field(
        40.0, ge=0.0, le=255.0, description="Smoothed power above which a peak is a return, whatever the noise [0..255]."
    )
    contrast: float = Field(
        7.0,
        gt=0.0,
        description="Detection threshold in low-noise data, above the median power and in units of the noise spread "
        "(median minus 10th percentile). The lower of this threshold and `threshold` applies.",
    )
    most_returns: int = Field(
        1000,
        ge=1,
        description="Number of returns that are kept per scan, the strongest first. Returns that stand out of the noise "
        "by `contrast` are all kept, even beyond this number.",
    )
    min_range_m: float = Field(2.5, ge=0.0, description="Nearer returns are dropped [m]: they are from the vehicle itself.")
    max_range_m: float = Field(
        150.0, gt=0.0, description="Farther returns are dropped [m]: they are too blurred across the beam to help."
    )

    @model_validator(mode="after")
    def _check_ranges(self) -> DetectorConfig:
        if self.max_range_m <= self.min_range_m:
            raise ValueError(f"max_range_m ({self.max_range_m}) must be larger than min_range_m ({self.min_range_m})")
        return self


class PsiConfig(Section):
    """Parameters of the published score, which only `mqslam score` and `mqslam.score` take: a run minimises another score.

    They are named as in the paper. The paper gives no values: the defaults are ours.

    Source: "Motion Estimation from Map Quality with Millimeter Wave Radar".
    """

    s: float = Field(2.0, gt=0.0, description="Radius of a point's neighbourhood [m].")
    beta_s: float = Field(1.0, gt=0.0, description="Width of the spatial kernel [m].")
    alpha_t: float | None = Field(
        None,
        ge=0.0,
        description="Difference in time at which the temporal kernel peaks [s]; null takes one revolution of the radar.",
    )
    beta_t: float = Field(0.06, gt=0.0, description="Width of the temporal kernel [s].")
    tau: float = Field(0.5, gt=0.0, description="Width of the Lorentzian [m].")
    temporal: Literal["plateau", "gaussian"] = Field(
        "plateau",
        description="Temporal kernel: plateau is 1 for time differences of alpha_t or more; gaussian is equation (8).",
    )
    numerator: Literal["tau/2", "tau"] = Field(
        "tau/2", description="Numerator of the Lorentzian: tau/2 as in equation (9), or tau as in Algorithm 1."
    )
    factor: Literal["distance", "kappa"] = Field(
        "distance", description="Factor on the Lorentzian: distance is s_ij of equation (10), kappa is that of Algorithm 1."
    )
    unmatched: float = Field(
        1.0,
        ge=0.0,
        description="Cost of a point without a neighbour, in units of the largest cost of a pair; 0 is as in the paper.",
    )

    @property
    def charge(self) -> float:
        """Cost of one point without a neighbour, in the unit of the score."""
        return self.unmatched * (2.0 * self.s / (math.pi * self.tau)) ** 2


class EstimatorConfig(Section):
    """Settings of the score that the estimator minimises, and of its minimisation."""

    s: float = Field(0.6, gt=0.0, description="Distance beyond which neighbours do not count, at the end of annealing [m].")
    s_start: float = Field(
        2.5, gt=0.0, description="Distance beyond which neighbours do not count, at the start of annealing [m]."
    )
    beta_s: float = Field(0.25, gt=0.0, description="Width of the spatial kernel at the end of annealing [m].")
    beta_s_start: float = Field(1.25, gt=0.0, description="Width of the spatial kernel at the start of annealing [m].")
    blur_m: float = Field(
        0.15,
        ge=0.0,
        description="Standard deviation [m], in any direction, by which returns of one object scatter from view to view.",
    )
    sigma_range_m: float = Field(0.15, gt=0.0, description="Standard deviation of a return along the ray [m].")
    sigma_azimuth: float = Field(0.008, gt=0.0, description="Standard deviation of a return across the ray [rad].")
    cluster_m: float = Field(
        2.0,
        gt=0.0,
        json_schema_extra=EXPERT,
        description="Side of the cells [m] within which returns count as one object in the covariance of a minimum, "
        "because their errors are not independent.",
    )


# Number of scans on which the track of a segment warms up, so that the segment's own scans are matched to a map that has
# grown. A segment begins only where this many scans in a row hold enough returns.
WARM_UP_SCANS = 36


class TrackerConfig(Section):
    """Settings of the front end psi, which matches every scan to a running map."""

    sigma_omega: float = Field(
        0.03, gt=0.0, description="Usual change of yaw rate per 0.25 s that yaw acceleration does not explain [rad/s]."
    )
    sigma_alpha: float = Field(0.2, gt=0.0, description="Usual change of yaw acceleration per 0.25 s [rad/s^2].")
    speed_max: float = Field(40.0, gt=0.0, description="Fastest speed that the cold start tries [m/s].")

    stamp_sigma_s: float | None = Field(
        None,
        ge=0.0,
        description="Standard deviation of a scan's stamp [s]. null takes the reader's estimate if scans are stamped as "
        "they arrive, and 0 if stamps are the radar's own.",
    )

    segment_scans: int = Field(
        0,
        ge=0,
        description="Number of scans per segment. Segments are tracked independently, so that several workers can track at "
        "the same time; 300 suits long recordings. With 0 a recording is one segment. Of two drives of a thousand scans, "
        "one drifted by 3 % less in segments, and one by 30 % more, in a bend where both tracks err.",
    )

    @field_validator("segment_scans")
    @classmethod
    def _check_segments(cls, segment_scans: int) -> int:
        if 0 < segment_scans < 2 * WARM_UP_SCANS:
            raise ValueError(f"must be 0 or at least {2 * WARM_UP_SCANS}, twice as many scans as a track warms up on")
        return segment_scans


class ScanMatchingConfig(Section):
    """Settings of the front ends kiss_icp, open3d_icp and small_gicp, which match scans to maps of their own."""

    strongest: float | None = Field(
        None,
        gt=0.0,
        le=1.0,
        description="Share of each scan's returns that is used, the strongest first. null takes the share with which the "
        "front end drifts least in simulated cities, and all returns of a lidar.",
    )
    voxel_size_m: float | None = Field(
        None,
        gt=0.0,
        description="Side of the map's voxels [m]. null takes the size with which the front end drifts least in simulated "
        "cities.",
    )
    max_range_m: float = Field(100.0, gt=0.0, description="Farther returns are dropped [m].")


class KissIcpConfig(Section):
    """Settings of the KISS-ICP front end."""

    config_file: Path | None = Field(
        None,
        description="YAML file of KISS-ICP's own settings, which replaces voxel_size_m and max_range_m of section "
        "scan_matching; null uses these two.",
    )


class Open3dIcpConfig(Section):
    """Settings of the Open3D ICP front end."""

    method: Literal["point_to_point", "generalized"] = Field(
        "point_to_point",
        description="Open3D's registration to use; generalized takes three times as long and drifts no less.",
    )


class OdometryConfig(Section):
    """Errors that the front end `odometry` and the pose graph assume for odometry that does not state its errors."""

    sigma_travel: float = Field(
        0.05,
        ge=0.0,
        description="Standard deviation of a distance, as a share of the distance. A run that can estimate a better value "
        "uses the estimate.",
    )
    sigma_yaw_rate: float = Field(0.02, gt=0.0, description="Standard deviation of the yaw rate [rad/s].")


class LoopConfig(Section):
    """Settings of loop closures."""

    enabled: bool = Field(True, description="Whether to search for loops.")


class RefinementConfig(Section):
    """Settings of the refinement of a trajectory, once its loops are closed."""

    rounds: int = Field(
        0,
        ge=0,
        description="Largest number of rounds in which every scan is registered on the earlier passes around it. Each round "
        "starts from the result of the round before. 0 leaves the refinement out: after two rounds, passes lie better "
        "on each other, but the trajectory as a whole was not always nearer to the truth.",
    )


class MapConfig(Section):
    """Settings of the rendered map."""

    cell_m: float = Field(0.2, gt=0.0, description="Side of a cell of the nav2 map [m].")


class MergeConfig(Section):
    """Settings of the merge of several recordings into one map."""

    changes: bool = Field(True, description="Whether to search for changes between the recordings.")


class AuditConfig(Section):
    """Settings of the audit, which judges a map."""

    # An audited trajectory may come from any program, and may drift more than our own does before loops are closed.
    spacing_m: float = Field(
        10.0, gt=0.0, description="Path [m] between the scans for which the audit looks for an earlier pass of the place."
    )
    least_path_m: float = Field(
        60.0, gt=0.0, description="Two scans with less path between them [m] are not two passes: odometry ties them already."
    )
    reach_m: float = Field(12.0, gt=0.0, description="Largest distance [m] at which two passes see the same things.")
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
        0.45, gt=0.0, lt=1.0, description="At least this share of the later pass's returns must lie on the earlier pass."
    )
    bend_m: float = Field(
        0.05, ge=0.0, description="A window whose best correction moves its points by less than this [m] is not torn."
    )
    jump_m: float = Field(0.1, ge=0.0, description="A step that moves the points after it by less than this [m] is no jump.")
    radius_m: float = Field(
        1.0,
        gt=0.0,
        description="Radius [m] of the neighbourhoods in which entropies and plane variance are computed. Cells of the "
        "evidence grid are half as wide.",
    )
    submap_spacing_m: float = Field(5.0, gt=0.0, description="Path [m] between the scans that a submap is rendered from.")
    torn_m: float = Field(0.5, gt=0.0, description="Two passes are torn if they are farther apart than this [m].")
    torn_rad: float = Field(
        0.0175, gt=0.0, description="Two passes are also torn if one is rotated against the other by more than this [rad]."
    )
    drift: float = Field(0.02, ge=0.0, description="Drift per length of path that the search allows for [m/m].")
    drift_rad: float = Field(1e-4, ge=0.0, description="Yaw drift per length of path that the search allows for [rad/m].")
    scan_matched: float = Field(
        0.6,
        gt=0.0,
        le=1.0,
        json_schema_extra=EXPERT,
        description="Factor on audit.matched where single scans are compared. Each scan has noise of its own, so that two "
        "scans share fewer points than two maps of many scans.",
    )


class VerdictConfig(Section):
    """Settings of the verdict: how often it may call a good map bad, and which faults it tolerates."""

    false_alarms: float = Field(
        0.01,
        gt=0.0,
        lt=0.5,
        description="Probability that the tests that give p-values, taken together, call a good map bad.",
    )
    tolerance_m: float | None = Field(
        None,
        gt=0.0,
        description="Tolerated distance between two passes [m]. Other tolerances (bend_m, jump_m and torn_rad of section "
        "audit) change in proportion. null takes audit.torn_m, and leaves the others as they are.",
    )


class Config(Section):
    """All settings of a run."""

    reading: ReadingConfig = ReadingConfig()
    sensor: SensorConfig = SensorConfig()
    detector: DetectorConfig = DetectorConfig()
    psi: PsiConfig = PsiConfig()
    estimator: EstimatorConfig = EstimatorConfig()
    tracker: TrackerConfig = TrackerConfig()
    scan_matching: ScanMatchingConfig = ScanMatchingConfig()
    kiss_icp: KissIcpConfig = KissIcpConfig()
    open3d_icp: Open3dIcpConfig = Open3dIcpConfig()
    odometry: OdometryConfig = OdometryConfig()
    loops: LoopConfig = LoopConfig()
    refinement: RefinementConfig = RefinementConfig()
    merge: MergeConfig = MergeConfig()
    map: MapConfig = MapConfig()
    audit: AuditConfig = AuditConfig()
    verdict: VerdictConfig = VerdictConfig()


ConfigSource: TypeAlias = Config | Mapping[str, Any] | Path | str | None
"""Settings as a user may give them: a `Config`, a dict of the settings that differ from a command's defaults, such as
`{"detector": {"threshold": 60}}`, the path of a YAML file, the name of a shipped configuration, or None for the defaults."""


def load_config(source: ConfigSource = None, default: Callable[[], Config] | None = None) -> Config:
    """Loads settings: the defaults with or without changes, or the settings in a YAML file or a shipped configuration.

    Args:
        source: a `Config`, which is returned as it is; a dict of sections with changes of the default settings; the path of
            a YAML file; the name of a shipped configuration, such as `oxford`; or None, which takes the default settings.
        default: makes the default settings; None stands for `Config`.

    Raises:
        ConfigError: the file does not exist or is not YAML, or a setting is unknown or out of range.
    """
    if isinstance(source, Config):
        return source
    if source is None or isinstance(source, Mapping):
        return change_config(Config() if default is None else default(), source or {})
    expected = "a Config, a dict of the settings that differ, the path of a YAML file, the name of a shipped one, or None"
    require_type(source, Path | str, "config", expected)
    return check_tree(Config, source, read_tree(source))


def read_tree(source: Path | str) -> dict[str, Any]:
    """Reads a file of settings as a dict of sections, without checking that this version of mqslam knows the settings.

    Args:
        source: path of a YAML file, or name of a shipped configuration.

    Raises:
        ConfigError: the file does not exist, or is not YAML in the form of settings.
    """
    path = Path(source)
    shipped = resources.files("mqslam.configs") / f"{source}.yaml"
    try:
        if path.is_file():
            content: str | bytes = untrusted.read_document(path, untrusted.YAML_BYTES)
        elif shipped.is_file():
            content = shipped.read_bytes()
        elif path.is_dir():
            raise ConfigError(f"{source}: is a folder; give a YAML file, such as the config.yaml in it that a run writes")
        else:
            raise ConfigError(f"{source}: no such configuration and no such file; {suggest(path.stem, list_shipped())}")
    except (OSError, ValueError) as error:
        raise ConfigError(f"{source}: is not a readable YAML file ({error})") from error
    return parse_tree(source, content)


def change_config(config: Config, changes: Mapping[str, Any]) -> Config:
    """Returns settings with some of them changed.

    Args:
        config: the settings before.
        changes: sections with the new values, such as `{"detector": {"threshold": 60}}`.

    Raises:
        ConfigError: a setting is unknown or out of range.
    """
    if not changes:
        return config
    tree = config.model_dump()
    for name, section in changes.items():
        both = isinstance(section, Mapping) and name in tree
        tree[name] = {**tree[name], **section} if both else section
    return check_tree(Config, "given settings", tree)


def list_shipped() -> list[str]:
    """Returns the names of the configurations that ship with mqslam."""
    folder = resources.files("mqslam.configs")
    return sorted(entry.name[:-5] for entry in folder.iterdir() if entry.name.endswith(".yaml"))


def set_doppler_beta(config: Config, doppler_beta: float) -> Config:
    """Returns the settings with `sensor.doppler_beta` [s] set to the value that a command used, for its config.yaml."""
    return set_values(config, "sensor", doppler_beta=doppler_beta)


def set_values(config: Config, section: str, **changed: float | str | Path | None) -> Config:
    """Returns the settings with some values of a section replaced, given by name; the new values are not checked."""
    return config.model_copy(update={section: getattr(config, section).model_copy(update=changed)})


def set_tolerance(config: Config, metres: float | None) -> Config:
    """Returns the settings with another tolerance of the verdict [m]; None leaves the settings as they are.

    Raises:
        ConfigError: the tolerance is not positive and finite.
    """
    if metres is None:
        return config
    require_type(metres, Real, "tolerance", "a number of metres")
    if not 0.0 < metres < math.inf:
        raise ConfigError(f"a tolerance of {metres:g} m is not a length above 0; give one in metres, such as 0.3")
    return set_values(config, "verdict", tolerance_m=metres)


def dump_yaml(config: Config) -> str:
    """Returns all settings as YAML, which `load_config` can read."""
    text: str = yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False)
    return text


def explain_yaml(config: Config, *, everything: bool = True) -> str:
    """Returns the settings as YAML, each under a comment with its description and unit.

    Args:
        config: the settings.
        everything: True lists all settings; False leaves out those for experts that have their default values.
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
    """Returns the settings that differ between two configurations, each as (section.name, old JSON value, new one)."""
    differing = []
    for name, section in before:
        old, new = section.model_dump(mode="json"), getattr(after, name).model_dump(mode="json")
        differing += [(f"{name}.{key}", old[key], new[key]) for key in old if old[key] != new[key]]
    return differing
