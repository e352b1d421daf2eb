"""`mqslam config` shows every setting with its reason, what a file changes, and a schema that validates files."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml
from pydantic import BaseModel
from support.commands import mqslam

from mqslam.config import Config, load_config


def leaves() -> list[tuple[str, str]]:
    """Name and reason of every setting."""
    sections = ((name, type(section)) for name, section in Config())
    return [(f"{name}.{key}", f.description or "") for name, kind in sections for key, f in kind.model_fields.items()]


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
    assert "  # Number of scans that the map holds.\n  keyframes: 40\n" in shown.out
    assert json.loads(mqslam("config", "show", "--json").out) == Config().model_dump(mode="json")


def test_the_difference_of_files_is_what_they_change(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text("tracker: {keyframes: 20}\nsensor: {doppler_beta: 0.049}\n")
    shown = mqslam("config", "diff", tmp_path / "mine.yaml")
    assert shown.out.splitlines() == ["sensor.doppler_beta: null -> 0.049", "tracker.keyframes: 40 -> 20"]
    against = json.loads(mqslam("config", "diff", tmp_path / "mine.yaml", "oxford", "--json").out)
    assert against == {
        "sensor.range_resolution_m": {"from": 0.0438, "to": None},
        "tracker.keyframes": {"from": 40, "to": 20},
    }
    assert mqslam("config", "diff", "default").out == ""
    wrong = mqslam("config", "diff", "oxfrod")
    assert wrong.code == 2 and "oxfrod: no such configuration" in wrong.err


def test_the_schema_knows_every_setting_and_refuses_others() -> None:
    schema = json.loads(mqslam("config", "schema").out)
    for section, kind in ((name, type(value)) for name, value in Config()):
        described = schema["$defs"][schema["properties"][section]["$ref"].rpartition("/")[2]]
        assert issubclass(kind, BaseModel) and list(described["properties"]) == list(kind.model_fields)
        assert described["additionalProperties"] is False
    assert yaml.safe_load(mqslam("config", "show", "--all").out).keys() == schema["properties"].keys()
