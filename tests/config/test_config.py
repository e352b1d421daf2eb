"""Settings: every one is explained, a wrong one is refused by name, and `mqslam config` shows what files change."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from pydantic import BaseModel, Field, ValidationError, create_model
from support.commands import mqslam
from support.recordings import write_oxford

from mqslam.config import EXPERT, Config, MapConfig, dump_yaml, list_shipped, load_config
from mqslam.errors import ConfigError


def settings(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, str | None]]:
    """Yields name and description of every setting of a tree."""
    for name, field in model.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            yield from settings(field.annotation, f"{prefix}{name}.")
        else:
            yield prefix + name, field.description


def refusal(tmp_path: Path, text: str) -> str:
    """Returns the message with which a settings file is refused."""
    file = tmp_path / "mine.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_config(file)
    assert str(caught.value).startswith(f"{file}: ") and "\n" not in str(caught.value)
    return str(caught.value).removeprefix(f"{file}: ")


def test_every_setting_says_what_it_is_for_and_its_unit() -> None:
    described = dict(settings(Config))
    assert len(described) > 30
    for name, reason in described.items():
        unit = {"_m": "[m", "_rad": "[rad"}.get("_" + name.rpartition("_")[2])
        assert reason is not None and len(reason.split()) >= 3 and (unit is None or unit in reason), name


def test_no_file_and_the_shipped_default_are_the_defaults() -> None:
    assert load_config() == load_config("default") == Config()


def test_every_shipped_configuration_loads() -> None:
    assert {"boreas", "default", "mulran", "oxford", "radiate"} <= set(list_shipped())
    for name in list_shipped():
        assert isinstance(load_config(name), Config)
    assert load_config("oxford").sensor.range_resolution_m == 0.0438


def test_a_file_changes_what_it_names_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text("tracker: {sigma_alpha: 0.7}\npsi: {tau: 0.5}\n")
    changed = load_config(tmp_path / "mine.yaml")
    assert changed.tracker.sigma_alpha == 0.7 and changed.psi.tau == 0.5
    tracker = Config().tracker.model_copy(update={"sigma_alpha": 0.7})
    assert changed == Config(tracker=tracker, psi=Config().psi.model_copy(update={"tau": 0.5}))


def test_a_file_goes_before_a_shipped_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("oxford").write_text("map: {cell_m: 3.0}")
    assert load_config("oxford").map.cell_m == 3.0


@pytest.mark.parametrize("text", ["", "# nothing\n", "{}", "map: {}"])
def test_a_file_without_settings_is_the_default(tmp_path: Path, text: str) -> None:
    (tmp_path / "mine.yaml").write_text(text)
    assert load_config(tmp_path / "mine.yaml") == Config()


@pytest.mark.parametrize("name", ["default", "oxford"])
def test_what_is_written_is_read_back_equal(tmp_path: Path, name: str) -> None:
    config = load_config(name)
    (tmp_path / "written.yaml").write_text(dump_yaml(config))
    assert load_config(tmp_path / "written.yaml") == config
    assert all(f"{setting.split('.')[-1]}:" in dump_yaml(config) for setting, _ in settings(Config))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("psi: {bta_s: 1}", "unknown setting psi.bta_s; did you mean beta_s?"),
        ("trackr: {}", "unknown setting trackr; did you mean tracker?"),
        ("threshold: 60", "unknown setting threshold; did you mean detector.threshold?"),
        ("beta_s: 60", "unknown setting beta_s; did you mean psi.beta_s or estimator.beta_s?"),
        ("treshold: 60", "unknown setting treshold; did you mean detector.threshold?"),
        ("map: {cell_m: -1}", "map.cell_m: must be greater than 0"),
        ("map: {cell_m: wide}", "map.cell_m: must be a valid number"),
        ("map: {stop_s: 3, cell_m: -1}", "unknown setting map.stop_s; choose one of cell_m, or leave it out"),
        ("{detector: {join_bins: 2}, recognition: {row: 4}}", "unknown settings detector.join_bins, recognition; correct"),
        ("map: {a: 1, b: 1, c: 1, d: 1, e: 1, f: 1, g: 1}", "map.a, map.b, map.c, map.d, map.e and 2 others; correct them"),
        ("map: 3", "map: must be"),
        ("sensor: {doppler_beta: 5}", "sensor.doppler_beta: must be less than or equal to 1"),
        ("detector: {min_range_m: 3, max_range_m: 2}", "detector: max_range_m (2.0) must be larger than min_range_m (3.0)"),
        ("tracker: {segment_scans: 71}", "tracker.segment_scans: must be 0 or at least 72"),
        ("detector.threshold: 60", "unknown setting detector.threshold; write it as detector: {threshold: ...}"),
        ("detector: {threshold: .nan}", "detector.threshold: must be a finite number"),
        ("psi: {unmatched: .inf}", "psi.unmatched: must be a finite number"),
        ("1: 2", "Keys should be strings"),
        ("- map", "must hold settings"),
        ("map", "must hold settings"),
        ("map:\n  a: [", "is not a readable YAML file (line 2: "),
        ("!!python/object/apply:os.getcwd []", "is not a readable YAML file"),
    ],
)
def test_a_wrong_setting_is_refused_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    assert message in refusal(tmp_path, text)


def test_a_file_that_is_no_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(ConfigError, match="is not a readable YAML file"):
        load_config(tmp_path / "mine.yaml")


@pytest.mark.parametrize(
    ("name", "remedy"),
    [("oxfrd", r"did you mean oxford\?$"), ("mine", "choose one of boreas, default, .*oxford")],
)
def test_an_unknown_name_is_answered_with_the_nearest_or_all_that_ship(name: str, remedy: str) -> None:
    with pytest.raises(ConfigError, match=f"^{name}: no such configuration and no such file; {remedy}"):
        load_config(name)


def test_a_folder_is_no_configuration(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="is a folder; give a YAML file, such as"):
        load_config(tmp_path)


def test_only_an_unknown_setting_that_resembles_none_may_be_left_out(tmp_path: Path) -> None:
    assert "leave it out" not in refusal(tmp_path, "detector: {treshold: 60}")
    assert refusal(tmp_path, "map: {stop_s: 3}").endswith(", or leave it out")


def test_settings_do_not_change_after_they_were_read() -> None:
    with pytest.raises(ValidationError):
        Config().map.cell_m = 1.0  # type: ignore[misc]


def shown_in(text: str) -> set[tuple[str, str]]:
    """Returns section and name of every setting that a YAML text names."""
    return {(name, key) for name, section in yaml.safe_load(text).items() for key in section}


def test_what_is_shown_is_read_back_the_same_and_explains_itself(tmp_path: Path) -> None:
    shown = mqslam("config", "show", "oxford")
    assert shown.code == 0
    (tmp_path / "mine.yaml").write_text(shown.out)
    assert load_config(tmp_path / "mine.yaml") == load_config("oxford")
    assert (
        f"  # Usual change of yaw acceleration per 0.25 s [rad/s^2].\n  sigma_alpha: {Config().tracker.sigma_alpha}\n"
        in shown.out
    )
    assert json.loads(mqslam("config", "show", "--json").out) == Config().model_dump(mode="json")


def test_an_expert_setting_is_shown_on_request_and_where_a_file_changes_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fields = {"finesse": (float, Field(2.0, gt=0.0, description="how fine it is", json_schema_extra=EXPERT))}
    section = create_model("Section", __base__=MapConfig, __doc__="The map.", **fields)
    settings = create_model("Settings", __base__=Config, map=(section, section()))
    monkeypatch.setattr("mqslam.config.Config", settings)
    kinds = {name: type(kind).model_fields for name, kind in settings()}
    experts = {
        (name, key) for name, fields in kinds.items() for key, field in fields.items() if field.json_schema_extra == EXPERT
    }
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
        "sensor.range_resolution_m": {"from": None, "to": 0.0438},
        "tracker.sigma_alpha": {"from": 0.3, "to": Config().tracker.sigma_alpha},
    }
    assert mqslam("config", "diff", "default").out == "the same\n"
    assert json.loads(mqslam("config", "diff", "default", "--json").out) == {}
    wrong = mqslam("config", "diff", "oxfrod")
    assert wrong.code == 2 and "oxfrod: no such configuration and no such file; did you mean oxford?" in wrong.err


def test_the_schema_knows_every_setting_and_refuses_others() -> None:
    schema = json.loads(mqslam("config", "schema").out)
    for section, kind in ((name, type(value)) for name, value in Config()):
        described = schema["$defs"][schema["properties"][section]["$ref"].rpartition("/")[2]]
        assert issubclass(kind, BaseModel) and list(described["properties"]) == list(kind.model_fields)
        assert described["additionalProperties"] is False
    assert yaml.safe_load(mqslam("config", "show", "--all").out).keys() == schema["properties"].keys()


def test_a_dict_changes_the_defaults_of_a_command_and_nothing_else() -> None:
    changed = load_config({"detector": {"threshold": 60}}, lambda: load_config("oxford"))
    assert changed.detector.threshold == 60.0 and changed.sensor == load_config("oxford").sensor
    assert load_config({}) == Config() and load_config(changed) is changed
    with pytest.raises(ConfigError, match=r"^given settings: unknown setting detector.treshold; did you mean threshold\?"):
        load_config({"detector": {"treshold": 60}})
    with pytest.raises(ConfigError, match=r"^given settings: detector: "):
        load_config({"detector": 60})


def test_an_option_sets_a_single_setting(tmp_path: Path) -> None:
    drive = write_oxford(tmp_path / "drive")

    def resolution(*words: str) -> float:
        shown = mqslam("info", drive, "--json", *words)
        assert (shown.code, shown.err) == (0, "")
        return float(json.loads(shown.out)["range_resolution_m"])

    assert resolution("--set", "sensor.range_resolution_m=0.1") == 0.1
    assert resolution("--config", "oxford", "--set", "sensor.range_resolution_m=0.1") == 0.1
    assert resolution("--config", "oxford", "--set", "sensor.range_offset_m=-0.3") == 0.0438
    for wrong, reason in (
        ("detector.threshold", "give SECTION.NAME=VALUE"),
        ("threshold=60", "give SECTION.NAME=VALUE"),
        ("detector.threshold=[", "the value '[' is not valid YAML; put it in quotes"),
        ("detector.treshold=60", "did you mean threshold?"),
        ("detector.threshold=many", "detector.threshold: must be a valid number"),
    ):
        shown = mqslam("info", drive, "--set", wrong)
        assert shown.code == 2 and reason in shown.err and shown.err.count("\n") == 1, shown.err
    shown = mqslam("info", drive, "--set", "detector.threshold=50", "--set", "detector.threshold=60")
    assert shown.code == 2 and "detector.threshold is set twice" in shown.err
