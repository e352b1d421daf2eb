"""`mqslam config` shows every setting with its reason, what a file changes, and a schema that validates files."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml
from pydantic import BaseModel, create_model
from support.commands import mqslam

from mqslam.config import Config, MapConfig, load_config
from mqslam.config.fields import expert, is_expert


def leaves() -> list[tuple[str, str]]:
    """Returns name and reason of every setting."""
    sections = ((name, type(section)) for name, section in Config())
    return [(f"{name}.{key}", f.description or "") for name, kind in sections for key, f in kind.model_fields.items()]


def shown_in(text: str) -> set[tuple[str, str]]:
    """Returns section and name of every setting that a YAML text names."""
    return {(name, key) for name, section in yaml.safe_load(text).items() for key in section}


@pytest.mark.parametrize(("name", "reason"), leaves())
def test_every_setting_says_what_it_is_for(name: str, reason: str) -> None:
    assert len(reason.split()) >= 3
    unit = {"_m": "[m", "_rad": "[rad"}.get("_" + name.rpartition("_")[2])
    assert unit is None or unit in reason


def test_what_is_shown_is_read_back_the_same_and_explains_itself(tmp_path: Path) -> None:
    shown = mqslam("config", "show", "oxford")
    assert shown.code == 0
    (tmp_path / "mine.yaml").write_text(shown.out)
    assert load_config(tmp_path / "mine.yaml") == load_config("oxford")
    assert (
        f"  # Change of yaw acceleration per 0.25 s [rad/s^2].\n  sigma_alpha: {Config().tracker.sigma_alpha}\n" in shown.out
    )
    assert json.loads(mqslam("config", "show", "--json").out) == Config().model_dump(mode="json")


def test_an_expert_setting_is_shown_on_request_and_where_a_file_changes_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fields = {"finesse": (float, expert(2.0, gt=0.0, description="how fine it is"))}
    section = create_model("Section", __base__=MapConfig, __doc__="The map.", **fields)
    settings = create_model("Settings", __base__=Config, map=(section, section()))
    monkeypatch.setattr("mqslam.config.Config", settings)
    kinds = {name: type(kind).model_fields for name, kind in settings()}
    experts = {(name, key) for name, fields in kinds.items() for key, field in fields.items() if is_expert(field)}
    assert ("map", "finesse") in experts
    usual, everything = mqslam("config", "show").out, mqslam("config", "show", "--all").out
    assert shown_in(everything) == {(name, key) for name, fields in kinds.items() for key in fields}
    assert shown_in(usual) == shown_in(everything) - experts
    assert "  # how fine it is\n  finesse: 2.0\n" in everything
    assert json.loads(mqslam("config", "show", "--json").out)["map"]["finesse"] == 2.0
    (tmp_path / "mine.yaml").write_text("map: {finesse: 3.0}\n")
    assert "  finesse: 3.0\n" in mqslam("config", "show", tmp_path / "mine.yaml").out
    (tmp_path / "same.yaml").write_text("map: {finesse: 2.0}\n")
    assert mqslam("config", "show", tmp_path / "same.yaml").out == usual


def test_the_difference_of_files_is_what_they_change(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text("tracker: {sigma_alpha: 0.3}\nsensor: {doppler_beta: 0.049}\n")
    shown = mqslam("config", "diff", tmp_path / "mine.yaml")
    assert shown.out.splitlines() == [
        "sensor.doppler_beta: null -> 0.049",
        f"tracker.sigma_alpha: {Config().tracker.sigma_alpha} -> 0.3",
    ]
    against = json.loads(mqslam("config", "diff", tmp_path / "mine.yaml", "oxford", "--json").out)
    assert against == {
        "sensor.range_resolution_m": {"from": 0.0438, "to": None},
        "tracker.sigma_alpha": {"from": Config().tracker.sigma_alpha, "to": 0.3},
    }
    assert mqslam("config", "diff", "default").out == ""
    wrong = mqslam("config", "diff", "oxfrod")
    assert wrong.code == 2 and "oxfrod: no such configuration and no such file; did you mean oxford?" in wrong.err


def test_the_schema_knows_every_setting_and_refuses_others() -> None:
    schema = json.loads(mqslam("config", "schema").out)
    for section, kind in ((name, type(value)) for name, value in Config()):
        described = schema["$defs"][schema["properties"][section]["$ref"].rpartition("/")[2]]
        assert issubclass(kind, BaseModel) and list(described["properties"]) == list(kind.model_fields)
        assert described["additionalProperties"] is False
    assert yaml.safe_load(mqslam("config", "show", "--all").out).keys() == schema["properties"].keys()
