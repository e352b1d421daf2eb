"""Reads a YAML file as a tree of settings; a mistake in it becomes an error of one line."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar, get_args

import yaml
from pydantic import BaseModel, ValidationError

from mqslam.config.gone import is_gone
from mqslam.errors import ConfigError, suggest, untrusted

M = TypeVar("M", bound=BaseModel)
_NAMED = 5  # so many gone settings are named in an error


def parse_yaml(model: type[M], name: str | Path, text: str | bytes) -> M:
    """Returns the settings in a YAML text.

    Args:
        model: the kind of settings.
        name: name of the file, for errors.
        text: content of the file; bytes are UTF-8.

    Raises:
        ConfigError: the text is not YAML, or a setting is unknown or out of range.
    """
    try:
        tree = yaml.safe_load(text if isinstance(text, str) else untrusted.decode(text))
    except yaml.MarkedYAMLError as error:
        where = f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""
        raise ConfigError(f"{name}: is not a readable YAML file ({where}{error.problem or error.context})") from error
    except Exception as error:  # PyYAML lets through what making numbers, dates and keys raises
        first = (str(error) or type(error).__name__).splitlines()[0]
        raise ConfigError(f"{name}: is not a readable YAML file ({first})") from error
    if tree is None:
        tree = {}
    if not isinstance(tree, dict):
        raise ConfigError(f"{name}: must hold settings in the form 'section: {{key: value}}'")
    try:
        return model.model_validate(tree)
    except ValidationError as error:
        raise ConfigError(f"{name}: {_explain(error, model)}") from error


def _explain(error: ValidationError, model: type[BaseModel]) -> str:
    """Returns the first fault of a settings tree in one line, with the nearest known name for an unknown one."""
    faults = error.errors()
    gone = [
        f["loc"] for f in faults if f["type"] == "extra_forbidden" and len(f["loc"]) == 2 and is_gone(*map(str, f["loc"]))
    ]
    if gone:
        return _explain_gone([".".join(map(str, loc)) for loc in gone])
    fault = next((f for f in faults if f["type"] == "extra_forbidden"), faults[0])  # an unknown name explains a missing one
    where = ".".join(str(part) for part in fault["loc"])
    if fault["type"] != "extra_forbidden":
        return f"{where}: {fault['msg'].removeprefix('Value error, ')}"  # pydantic's prefix of what our own checks raise
    return f"unknown setting {where}; {suggest(str(fault['loc'][-1]), _list_settings(model, fault['loc'][:-1]))}"


def _explain_gone(names: list[str]) -> str:
    """Returns why settings of a former version are refused."""
    others = f" and {len(names) - _NAMED} others" if len(names) > _NAMED else ""
    are, they = ("is", "it") if len(names) == 1 else ("are", "them")
    listed = ", ".join(names[:_NAMED])
    return f"{listed}{others} {are} no setting any more, but fixed: nobody had a reason to change {they}; leave {they} out"


def _list_settings(model: type[BaseModel], parents: tuple[int | str, ...]) -> list[str]:
    """Returns the names of the settings below some parents; a number among the parents is a place in a list."""
    node: Any = model
    for parent in parents:
        node = get_args(node)[0] if isinstance(parent, int) else node.model_fields[parent].annotation
    return list(node.model_fields)
