"""Reads settings from YAML as a tree of dicts and lists; each mistake in the text becomes an error message of one line."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final, TypeVar, get_args

import yaml
from pydantic import BaseModel, ValidationError

from mqslam.errors import ConfigError, find_near, suggest, untrusted

M = TypeVar("M", bound=BaseModel)
_NAMED: Final = 5  # largest number of unknown settings that an error names
_PLAIN: Final = {"missing": "is missing", "model_type": "must be a section in the form '{key: value}'"}
_FORM: Final = "settings in the form 'section: {key: value}'"


def parse_tree(name: str | Path, text: str | bytes, form: str = _FORM) -> dict[str, Any]:
    """Returns the settings in a YAML text as a tree of dicts; the settings may be those of another version of mqslam.

    Args:
        name: name of the file, for errors.
        text: content of the file; bytes are UTF-8.
        form: the expected content of the text, in words, for errors.

    Raises:
        ConfigError: the text is not YAML, or its outermost value is not a mapping.
    """
    try:
        tree = yaml.safe_load(text if isinstance(text, str) else untrusted.decode(text))
    except yaml.MarkedYAMLError as error:
        where = f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""
        raise ConfigError(f"{name}: is not a readable YAML file ({where}{error.problem or error.context})") from error
    except Exception as error:  # PyYAML passes on errors of Python that invalid numbers, dates and keys raise
        first = (str(error) or type(error).__name__).splitlines()[0]
        raise ConfigError(f"{name}: is not a readable YAML file ({first})") from error
    if tree is None:
        tree = {}
    if not isinstance(tree, dict):
        raise ConfigError(f"{name}: must hold {form}")
    return tree


def check_tree(model: type[M], name: str | Path, tree: dict[str, Any]) -> M:
    """Checks a tree of settings, such as `parse_tree` returns, and converts it to an object of the class `model`.

    Raises:
        ConfigError: a setting is unknown or out of range; the error begins with `name`, the name of the file.
    """
    try:
        return model.model_validate(tree)
    except ValidationError as error:
        raise ConfigError(f"{name}: {_explain(error, model)}") from error


def _explain(error: ValidationError, model: type[BaseModel]) -> str:
    """Describes an error of pydantic in one line: the unknown settings, or the first fault if no setting is unknown."""
    faults = error.errors()
    unknown = [".".join(map(str, fault["loc"])) for fault in faults if fault["type"] == "extra_forbidden"]
    if len(unknown) > 1:
        others = f" and {len(unknown) - _NAMED} others" if len(unknown) > _NAMED else ""
        return f"unknown settings {', '.join(unknown[:_NAMED])}{others}; correct them, or leave them out"
    if unknown:
        (loc,) = (fault["loc"] for fault in faults if fault["type"] == "extra_forbidden")
        name, known = str(loc[-1]), _list_settings(model, loc[:-1])
        section, _, setting = name.partition(".")
        if setting and section in known:
            return f"unknown setting {name}; write it as {section}: {{{setting}: ...}}, in a dict of Python with quotes"
        hint = suggest(name, known)
        if len(loc) == 1 and find_near(name, known) is None and (inside := _find_inside(model, name)):
            hint = f"did you mean {' or '.join(inside)}?"
        return f"unknown setting {unknown[0]}; {hint}" + ("" if hint.endswith("?") else ", or leave it out")
    where = ".".join(map(str, faults[0]["loc"]))
    said = _PLAIN.get(faults[0]["type"], faults[0]["msg"].removeprefix("Value error, "))  # pydantic puts this before ours
    return f"{where}: {said.replace('Input should be', 'must be')}"


def _find_inside(model: type[BaseModel], name: str) -> list[str]:
    """Searches all sections for the setting with the given name or the most similar one; returns matches as section.name."""
    sections: dict[str, Any] = {key: field.annotation for key, field in model.model_fields.items()}
    inside = {key: list(kind.model_fields) for key, kind in sections.items() if hasattr(kind, "model_fields")}
    near = find_near(name, sorted({setting for names in inside.values() for setting in names}))
    return [f"{key}.{near}" for key, names in inside.items() if near in names]


def _list_settings(model: type[BaseModel], path: tuple[int | str, ...]) -> list[str]:
    """Returns the names of the settings in a section; `path` leads to it by names of sections and indices of lists."""
    node: Any = model
    for step in path:
        node = get_args(node)[0] if isinstance(step, int) else node.model_fields[step].annotation
    return list(node.model_fields)
