"""What a batch is to run: RUNS.yaml."""

from __future__ import annotations

import re
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field

from mqslam.config import load_config, parse_yaml, shipped_names
from mqslam.core import frontend as frontends
from mqslam.errors import ConfigError
from mqslam.results.batch_results import Order


class PlannedRun(BaseModel):
    """One entry of RUNS.yaml; its paths are relative to that file."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    data: Path = Field(description="the recording")
    name: str | None = Field(None, description="folder of its results; null takes the recording's own name")
    frontend: str = Field("psi", description="name of the front end")
    odometry: str = Field("auto", description="auto (the recording's own, if it has one), none, or a file")
    config: str | None = Field(None, description="a YAML file of settings, or the name of one that ships")


class Plan(BaseModel):
    """The content of RUNS.yaml."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    runs: list[PlannedRun] = Field(min_length=1, description="what to run")


def read_plan(path: Path) -> tuple[list[Order], str]:
    """The runs that a file asks for, and its text.

    Raises:
        ConfigError: it cannot be read, holds a mistake, or gives two runs one name.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: cannot be read ({error}); give a YAML file with the runs") from error
    plan = parse_yaml(Plan, path, text)
    orders: list[Order] = []
    for number, run in enumerate(plan.runs):
        try:
            orders.append(_order(run, path.absolute().parent, {order.name for order in orders}))
        except ConfigError as error:
            raise ConfigError(f"{path}: runs.{number}: {error}") from error
    return orders, text


def _order(run: PlannedRun, folder: Path, taken: set[str]) -> Order:
    data = folder / run.data
    name = run.name if run.name is not None else data.name
    if not re.fullmatch(r"\w[\w. -]*", name):
        raise ConfigError(f"name {name!r}: is to be the name of a folder; give one of letters and digits")
    if name in taken:
        raise ConfigError(f"name {name}: is that of another run; give one of them another name")
    frontends.find_entry_point(run.frontend)
    config = run.config if run.config is None or run.config in shipped_names() else folder / run.config
    odometry = run.odometry if run.odometry in ("auto", "none") else str(folder / run.odometry)
    return Order(name, data, run.frontend, odometry, load_config(config))
