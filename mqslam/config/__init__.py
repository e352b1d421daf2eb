"""All settings as one tree; each setting is defined with its unit and its reason."""

from __future__ import annotations

import textwrap
from importlib import resources
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ConfigDict

from mqslam.config.audit_config import AuditConfig, VerdictConfig
from mqslam.config.detector_config import DetectorConfig
from mqslam.config.estimator_config import EstimatorConfig
from mqslam.config.fields import is_expert
from mqslam.config.frontend_config import (
    KissIcpConfig,
    OdometryConfig,
    Open3dIcpConfig,
    ScanMatchingConfig,
)
from mqslam.config.loop_config import LoopConfig, RefinementConfig
from mqslam.config.map_config import MapConfig, MergeConfig
from mqslam.config.psi_config import PsiConfig
from mqslam.config.reading_config import ReadingConfig
from mqslam.config.sensor_config import SensorConfig
from mqslam.config.tracker_config import TrackerConfig
from mqslam.config.yaml_file import parse_yaml
from mqslam.errors import ConfigError, suggest, untrusted

__all__ = [
    "AuditConfig",
    "Config",
    "DetectorConfig",
    "EstimatorConfig",
    "KissIcpConfig",
    "LoopConfig",
    "MapConfig",
    "MergeConfig",
    "OdometryConfig",
    "Open3dIcpConfig",
    "PsiConfig",
    "ReadingConfig",
    "RefinementConfig",
    "ScanMatchingConfig",
    "SensorConfig",
    "TrackerConfig",
    "VerdictConfig",
    "dump_yaml",
    "explain_yaml",
    "list_changes",
    "list_shipped",
    "load_config",
    "set_doppler_beta",
    "set_false_alarms",
]


class Config(BaseModel):
    """All settings of a run."""

    model_config = ConfigDict(extra="forbid", frozen=True)

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


def forget_topics(config: Config) -> Config:
    """Returns the settings without the topics of a bag, as another recording needs them."""
    return set_sensor(config, radar_topic=None, odometry_topic=None, truth_topic=None)


def set_sensor(config: Config, **changed: float | str | None) -> Config:
    """Returns the settings with others of the section `sensor`, which are taken as they are."""
    return config.model_copy(update={"sensor": config.sensor.model_copy(update=changed)})


def set_false_alarms(config: Config, rate: float) -> Config:
    """Returns the settings with another rate of false alarms per recording."""
    return config.model_copy(update={"verdict": config.verdict.model_copy(update={"false_alarms": rate})})


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
            if everything or not is_expert(field) or values[key] != defaults[key]
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
