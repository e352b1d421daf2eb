"""The plan of a batch, which RUNS.yaml holds."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from mqslam.commands.inputs.extrinsics import parse_extrinsics, to_pose
from mqslam.config import list_shipped, load_config
from mqslam.config.yaml_file import parse_yaml
from mqslam.core import frontend as frontends
from mqslam.errors import ConfigError, untrusted
from mqslam.results.batch_results import Order

_CHOICES = ("auto", "none")  # instead of a file, or of extrinsics


class PlannedRun(BaseModel):
    """One entry of RUNS.yaml; its paths are relative to that file."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    data: Path = Field(description="the recording")
    name: str | None = Field(None, description="folder of its results; null takes the recording's own name")
    frontend: str = Field("psi", description="name of the front end")
    odometry: str = Field("auto", description="auto (the recording's own, if it has one), none, or a file")
    imu: str = Field("auto", description="gyroscope: auto (the recording's own, if it has one), none, or a file")
    gnss: str = Field("auto", description="auto (the recording's own, if its truth is not made from it), none, or a file")
    extrinsics: str = Field("auto", description="of the radar: auto (what the recording states), none, or X,Y,YAW")
    frame: Literal["radar", "vehicle"] = Field("radar", description="whose poses are written: radar or vehicle")
    config: str | None = Field(None, description="a YAML file of settings, or the name of one that ships")


class Plan(BaseModel):
    """The content of RUNS.yaml."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    runs: list[PlannedRun] = Field(min_length=1, description="what to run")


def read_plan(path: Path) -> tuple[list[Order], str]:
    """Reads the runs that a file asks for; returns them with the text of the file.

    Raises:
        ConfigError: the file cannot be read, holds a mistake, or gives two runs the same name.
    """
    try:
        text = untrusted.read_document(path, untrusted.YAML_BYTES)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8"
        raise ConfigError(f"{path}: cannot be read ({reason}); give a YAML file with the runs") from error
    plan = parse_yaml(Plan, path, text)
    orders: list[Order] = []
    for number, run in enumerate(plan.runs):
        try:
            orders.append(_prepare_order(run, path.absolute().parent, {order.name for order in orders}))
        except ConfigError as error:
            raise ConfigError(f"{path}: runs.{number}: {error}") from error
    return orders, text


def _prepare_order(run: PlannedRun, folder: Path, taken: set[str]) -> Order:
    """Returns a run with all paths resolved against a folder.

    Raises:
        ConfigError: its name cannot be that of a folder or is taken, its front end or settings are unknown, or its
            extrinsics are no pose.
    """
    data = folder / run.data
    name = run.name if run.name is not None else data.name
    if not re.fullmatch(r"\w[\w. -]*", name):
        raise ConfigError(f"name {name!r}: cannot be the name of a folder; give one of letters and digits")
    if name in taken:
        raise ConfigError(f"name {name}: is the name of another run too; give one of them another name")
    frontends.find_entry_point(run.frontend)
    config = run.config if run.config is None or run.config in list_shipped() else folder / run.config
    if run.extrinsics not in _CHOICES:
        to_pose(parse_extrinsics(run.extrinsics))
    odometry, imu, gnss = (
        choice if choice in _CHOICES else str(folder / choice) for choice in (run.odometry, run.imu, run.gnss)
    )
    return Order(name, data, run.frontend, load_config(config), odometry, imu, gnss, run.extrinsics, run.frame)
