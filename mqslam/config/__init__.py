"""All settings as one tree; every setting has its unit and reason where it is defined."""

from __future__ import annotations

import textwrap
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar, get_args

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError

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
from mqslam.config.reading_config import ReadingConfig
from mqslam.config.sensor_config import SensorConfig
from mqslam.config.tracker_config import TrackerConfig
from mqslam.config.verdict_config import VerdictConfig
from mqslam.errors import ConfigError, suggest

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
    "ReadingConfig",
    "ScanMatchingConfig",
    "SensorConfig",
    "TrackerConfig",
    "VerdictConfig",
    "changes",
    "dump_yaml",
    "explained_yaml",
    "load_config",
    "parse_yaml",
    "shipped_names",
    "with_doppler_beta",
]


M = TypeVar("M", bound=BaseModel)


class Config(BaseModel):
    """Every setting of a run."""

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
            raise ConfigError(f"{name}: no such configuration and no such file; {suggest(path.stem, shipped_names())}")
    except (OSError, ValueError) as error:
        raise ConfigError(f"{name}: cannot be read ({error})") from error
    return parse_yaml(Config, name, content)


def parse_yaml(model: type[M], name: str | Path, text: str | bytes) -> M:
    """Parses a YAML text as settings.

    Args:
        model: the kind of settings.
        name: of the file, for errors.
        text: its content, UTF-8 if bytes.

    Raises:
        ConfigError: the text is not YAML, or a setting is unknown or out of range.
    """
    try:
        tree = yaml.safe_load(text if isinstance(text, str) else text.decode("utf-8"))
    except Exception as error:  # PyYAML also raises what Python's own conversions to numbers, dates and keys raise
        first = (str(error) or type(error).__name__).splitlines()[0]
        raise ConfigError(f"{name}: is not a readable YAML file ({first})") from error
    if tree is None:
        tree = {}
    if not isinstance(tree, dict):
        raise ConfigError(f"{name}: must hold settings as 'section: {{key: value}}'")
    try:
        return model.model_validate(tree)
    except ValidationError as error:
        raise ConfigError(f"{name}: {_explain(error, model)}") from error


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


def _explain(error: ValidationError, model: type[BaseModel]) -> str:
    """Describes the first fault of a settings tree in one line, with the nearest known name for an unknown one."""
    faults = error.errors()
    # an unknown name comes first, since it may be the misspelt name of a setting that is reported as missing
    fault = next((f for f in faults if f["type"] == "extra_forbidden"), faults[0])
    where = ".".join(str(part) for part in fault["loc"])
    if fault["type"] != "extra_forbidden":
        return f"{where}: {fault['msg']}"
    return f"unknown setting {where}; {suggest(str(fault['loc'][-1]), _list_keys(model, fault['loc'][:-1]))}"


def _list_keys(model: type[BaseModel], parents: tuple[int | str, ...]) -> list[str]:
    """Lists the names of the settings below some parents; a number among them is a place in a list."""
    node: Any = model
    for parent in parents:
        node = get_args(node)[0] if isinstance(parent, int) else node.model_fields[parent].annotation
    return list(node.model_fields)
