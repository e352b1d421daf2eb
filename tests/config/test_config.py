"""Settings: every one is explained, a wrong one is refused by name, and a file reads back what was written."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from pydantic import BaseModel, ValidationError

from mqslam.config import Config, dump_yaml, list_shipped, load_config
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


def test_every_setting_says_what_it_is() -> None:
    described = dict(settings(Config))
    assert len(described) > 30
    assert [name for name, description in described.items() if not description] == []


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
        ("map: {zzzz: 1}", "unknown setting map.zzzz; choose one of cell_m"),
        ("map: {cell_m: -1}", "map.cell_m: Input should be greater than 0"),
        ("map: {cell_m: wide}", "map.cell_m: Input should be a valid number"),
        (
            "map: {stop_s: 3, cell_m: -1}",
            "map.stop_s is no setting any more, but fixed: nobody had a reason to change it; leave it out",
        ),
        ("recognition: {row: 4}", "recognition.row is no setting any more, but fixed: nobody had a reason to change it"),
        (
            "reading: {alike: 1.3, track_slack_s: 1}",
            "reading.alike, reading.track_slack_s are no setting any more, but fixed",
        ),
        (
            "sensor: {doppler_steps: 3}",
            "sensor.doppler_steps is no setting any more, but fixed: nobody had a reason to change",
        ),
        ("{localisation: {}}", "localisation is no setting any more, but fixed: nobody had a reason to change it"),
        ("recognition: {rwo: 4}", "recognition is no setting any more, but fixed: nobody had a reason to change it"),
        ("{detector: {join_bins: 2}, tracker: {beside_turn: 1}}", "detector.join_bins, tracker.beside_turn are no setting"),
        ("map: 3", "map: Input should be"),
        ("sensor: {doppler_beta: 5}", "sensor.doppler_beta: Input should be less than or equal to 1"),
        ("detector: {min_range_m: 3, max_range_m: 2}", "detector: max_range_m (2.0) must be larger than min_range_m (3.0)"),
        ("tracker: {segment_scans: 71}", "tracker.segment_scans: must be 0 or at least 72"),
        (
            "graph: {huber: 2}",
            "graph.huber is no setting any more, but fixed: nobody had a reason to change it; leave it out",
        ),
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


def test_settings_do_not_change_after_they_were_read() -> None:
    with pytest.raises(ValidationError):
        Config().map.cell_m = 1.0  # type: ignore[misc]
