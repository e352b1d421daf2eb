"""All settings as one tree; every setting has its unit and reason where it is defined."""

from __future__ import annotations

import textwrap
from importlib import resources
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ConfigDict

from mqslam.config.audit_config import AuditConfig, CompareConfig
from mqslam.config.check_config import CheckConfig
from mqslam.config.detector_config import DetectorConfig
from mqslam.config.estimator_config import EstimatorConfig
from mqslam.config.fields import is_expert
from mqslam.config.frontend_config import KissIcpConfig, OdometryConfig, Open3dIcpConfig, ScanMatchingConfig
from mqslam.config.graph_config import GraphConfig
from mqslam.config.loop_config import LoopConfig, PassConfig
from mqslam.config.map_config import MapConfig
from mqslam.config.psi_config import PsiConfig
from mqslam.config.reading import parsed
from mqslam.config.sensor_config import SensorConfig
from mqslam.config.tracker_config import TrackerConfig
from mqslam.config.verdict_config import VerdictConfig
from mqslam.errors import ConfigError

__all__ = [
    "AuditConfig",
    "CheckConfig",
    "CompareConfig",
    "Config",
    "DetectorConfig",
    "EstimatorConfig",
    "GraphConfig",
    "KissIcpConfig",
    "LoopConfig",
    "MapConfig",
    "OdometryConfig",
    "Open3dIcpConfig",
    "PassConfig",
    "PsiConfig",
    "ScanMatchingConfig",
    "SensorConfig",
    "TrackerConfig",
    "VerdictConfig",
    "changes",
    "dump_yaml",
    "explained_yaml",
    "load_config",
    "shipped_names",
    "with_doppler_beta",
]


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
    odometry: OdometryConfig = OdometryConfig()
    graph: GraphConfig = GraphConfig()
    loops: LoopConfig = LoopConfig()
    map: MapConfig = MapConfig()
    audit: AuditConfig = AuditConfig()
    verdict: VerdictConfig = VerdictConfig()
    compare: CompareConfig = CompareConfig()
    check: CheckConfig = CheckConfig()


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


def with_doppler_beta(config: Config, doppler_beta: float) -> Config:
    """The settings as a result's config.yaml states them: with the Doppler shift [s] that was used."""
    return config.model_copy(update={"sensor": config.sensor.model_copy(update={"doppler_beta": doppler_beta})})


def dump_yaml(config: Config) -> str:
    """Returns every setting as YAML that `load_config` reads back."""
    text: str = yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False)
    return text


def explained_yaml(config: Config, *, everything: bool = True) -> str:
    """Returns the settings as YAML with the reason and unit of each above it.

    Args:
        config: the settings.
        everything: whether settings that only an expert would touch are listed too; where they differ from the default
            they always are.
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


def changes(before: Config, after: Config) -> list[tuple[str, Any, Any]]:
    """Settings that differ: name, value before and value after, as JSON has them."""
    found = []
    for name, section in before:
        old, new = section.model_dump(mode="json"), getattr(after, name).model_dump(mode="json")
        found += [(f"{name}.{key}", old[key], new[key]) for key in old if old[key] != new[key]]
    return found
