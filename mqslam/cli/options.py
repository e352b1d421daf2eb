"""Declares the options that several commands share, and the decorator that makes a function a command with named options."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import wraps
from importlib import import_module
from inspect import Parameter, Signature
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import typer
from typer.core import TyperCommand, TyperGroup

from mqslam.cli.terminal import Terminal
from mqslam.errors import show_lines

if TYPE_CHECKING:
    from mqslam.auditing.verdict import VerdictStatus
    from mqslam.config import Config, ConfigSource

Options = Mapping[str, tuple[Any, Any]]
"""Type and typer declaration of each option, by the name of the function argument that gets its value."""

_PANELS: Final = {
    "Settings": "config changes",
    "Recording and sensors": "odometry imu gnss extrinsics frame format range_resolution topic start_s end_s strict",
    "Work and output": "jobs cluster resume force as_json quiet verbose",
}
"""Headings in the help, each with the names of the shared options below it."""
OF_WORK: Final = frozenset(f"{_PANELS['Settings']} {_PANELS['Work and output']} out plan".split())
"""Names of the options that change no result, and of options whose effect is in the settings of the result."""
_FAIL_ON: Final = {"warn": "the verdict is warn or fail", "fail": "the verdict is fail"}
"""The values of --fail-on, each with the verdicts at which the command exits with 1."""
_TOPICS: Final = {"radar": "radar_topic", "odometry": "odometry_topic", "truth": "truth_topic"}


class _FlagsWithoutType:
    """A base of commands whose help shows no type for options that only switch something on."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Returns the parameters of the command; parameters that are flags show no type in the help."""
        listed: list[Any] = super().get_params(ctx)  # type: ignore[misc]
        for parameter in listed:
            if getattr(parameter, "is_flag", False):
                parameter.metavar = ""
        return listed


class Command(_FlagsWithoutType, TyperCommand):
    """A command without subcommands, such as `mqslam run`."""


class Group(_FlagsWithoutType, TyperGroup):
    """A command with subcommands, such as `mqslam config`."""


def argument(kind: Any, default: Any, metavar: str, help: str, **more: Any) -> tuple[Any, Any]:
    """Returns the type and the declaration of a positional argument; `more` is passed on to `typer.Argument`."""
    return kind, typer.Argument(default, metavar=metavar, help=help, **more)


def option(kind: Any, default: Any, help: str, *names: str, **more: Any) -> tuple[Any, Any]:
    """Returns the type and the declaration of an option; `more` is passed on to `typer.Option`.

    Without `names`, such as `--out` and `-o`, the option is named like the function argument that gets its value.
    """
    return kind, typer.Option(default, *names, help=help, **more)


def flag(help: str, *names: str) -> tuple[Any, Any]:
    """Returns the type and the declaration of an option that switches something on."""
    return option(bool, False, help, *names)


def command(names: str, own: Options | None = None) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Returns a decorator that makes a function a command with the named options.

    The function gets the command's terminal, and the value of each option by its name. It does not get `jobs`, `cluster`,
    `as_json` and `quiet`, which the terminal holds, nor `verbose`. The values of `changes` (--set) and `topic` are put into
    the settings `config`. The function gets `topic` itself only if the command declares `topic` or `config` of its own.

    Args:
        names: names of the options, separated by spaces, in the order of the help.
        own: declarations of options that only this command has.
    """
    declared = {**OPTIONS, **(own or {})}
    parameters = [
        Parameter(name, Parameter.KEYWORD_ONLY, annotation=declared[name][0], default=declared[name][1])
        for name in names.split()
    ]

    def decorate(do: Callable[..., None]) -> Callable[..., None]:
        @wraps(do)
        def run(**given: Any) -> None:
            of_terminal = {name: given.pop(name) for name in ("jobs", "cluster", "as_json", "quiet") if name in given}
            given.pop("verbose", None)
            if changes := given.pop("changes", None):
                given["config"] = change_settings(given["config"], changes)
            if "topic" in given and declared["topic"] is OPTIONS["topic"] and declared["config"] is OPTIONS["config"]:
                given["config"] = state_topics(given["config"], given.pop("topic"))
            do(Terminal(**of_terminal), **given)

        run.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
        run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
        return run

    return decorate


def choose_exit_code(status: VerdictStatus, fail_on: Literal["warn", "fail"]) -> int:
    """Returns the exit code under --fail-on: 1 for a verdict as bad as `fail_on` or worse, 3 for `not judged`, else 0."""
    from mqslam.auditing.verdict import VerdictStatus

    if status is VerdictStatus.NOT_JUDGED:
        return 3
    return int(status is VerdictStatus.FAIL or (status is VerdictStatus.WARN and fail_on == "warn"))


def _check_fail_on(word: str | None) -> str | None:
    """Returns the value of --fail-on unchanged; None without the option.

    Raises:
        ConfigError: the value is neither warn nor fail.
    """
    if word is not None and word not in _FAIL_ON:
        from mqslam.errors import ConfigError

        choices = " or ".join(f"{name} (exits with 1 if {when})" for name, when in _FAIL_ON.items())
        raise ConfigError(f"--fail-on {word}: give {choices}; both exit with 3 if the map could not be judged")
    return word


def change_settings(config: str | None, changes: Sequence[str]) -> Config | dict[str, dict[str, Any]]:
    """Returns settings with the changes that --set makes.

    Args:
        config: path or name of the settings; None if the command itself chooses the settings.
        changes: texts SECTION.NAME=VALUE, with the values as in YAML.

    Returns:
        All settings; if `config` is None, only the changes, as {section: {name: value}}.

    Raises:
        ConfigError: a text has another form, a setting is changed twice, is unknown or is out of range.
    """
    import yaml

    from mqslam.config import change_config, load_config
    from mqslam.errors import ConfigError

    tree: dict[str, dict[str, Any]] = {}
    for text in changes:
        setting, equals, value = text.partition("=")
        section, dot, name = setting.strip().partition(".")
        if not (equals and dot and section and name):
            raise ConfigError(f"--set {text}: give SECTION.NAME=VALUE, such as detector.threshold=60")
        if name in tree.setdefault(section, {}):
            raise ConfigError(f"--set {text}: {section}.{name} is set twice; give it once")
        try:
            tree[section][name] = yaml.safe_load(value)
        except yaml.YAMLError as error:
            remedy = f"put it in quotes that the shell keeps, as in --set '{section}.{name}=\"TEXT\"'"
            raise ConfigError(f"--set {text}: the value '{value}' is not valid YAML; {remedy}") from error
    return tree if config is None else change_config(load_config(config), tree)


def state_topics(config: ConfigSource, topics: Sequence[str] | None) -> Config:
    """Returns settings with the topics of a bag that --topic names.

    Args:
        config: the settings, their path or name, or the settings that differ from the defaults.
        topics: texts radar=TOPIC, odometry=TOPIC or truth=TOPIC; TOPIC alone is the radar's. None names no topic.

    Raises:
        ConfigError: a topic is given for an unknown name, is empty, or is given twice; or the settings are wrong.
    """
    from mqslam.config import load_config, set_values
    from mqslam.errors import ConfigError, suggest

    named: dict[str, str] = {}
    for text in topics or ():
        of, equals, topic = text.partition("=")
        if not equals:
            of, topic = "radar", text
        if of not in _TOPICS:
            raise ConfigError(f"--topic {text}: '{of}' before '=' is no topic that mqslam reads; {suggest(of, _TOPICS)}")
        if not topic or _TOPICS[of] in named:
            problem = f"is the second topic for {of}" if topic else "names no topic"
            raise ConfigError(f"--topic {text}: {problem}; give it once, as {of}=TOPIC")
        named[_TOPICS[of]] = topic
    return set_values(load_config(config), "sensor", **named)


def _complete(module: str, find: Callable[[Any], Iterable[str]]) -> Callable[[str], list[str]]:
    """Returns a function that completes names for the shell; `find` returns all names, given the module of name `module`."""

    def complete(incomplete: str) -> list[str]:
        return [name for name in find(import_module(module)) if name.startswith(incomplete)]

    return complete


complete_config = _complete("mqslam.config", lambda module: module.list_shipped())


class _Shown(logging.Formatter):
    """A formatter of log lines that escapes control characters, since text from a file must not control the terminal."""

    def format(self, record: logging.LogRecord) -> str:
        """Returns the text of a log record, with control characters escaped."""
        return show_lines(super().format(record))


def set_verbosity(verbose: bool) -> bool:
    """Shows the log lines of mqslam on stderr if `verbose`, else only warnings; returns `verbose`, as typer expects."""
    log = logging.getLogger("mqslam")
    for handler in [h for h in log.handlers if isinstance(h, logging.StreamHandler)]:
        log.removeHandler(handler)
    if verbose:
        handler = logging.StreamHandler()
        handler.setFormatter(_Shown("%(name)s: %(message)s"))
        log.addHandler(handler)
    log.setLevel(logging.INFO if verbose else logging.WARNING)
    return verbose


_LAYOUTS: Final = (
    "a folder in the layout of Oxford Radar RobotCar, Boreas, MulRan or RADIATE, a ROS bag "
    "(.bag, .mcap, or the folder of a ROS 2 bag), "
)
OF_RADAR: Final = argument(Path, ..., "DATA", f"The recording of a radar: {_LAYOUTS}or an .npz file of `convert`.")
"""Declaration of `data` for commands that read no lidars."""

OPTIONS: Final[Options] = {
    "data": argument(
        Path,
        ...,
        "DATA",
        f"The recording: {_LAYOUTS}an .npz file of `convert`, or a planar lidar's CARMEN log or bag.",
    ),
    "out": option(Path, ..., "Folder for the results; it must not exist yet.", "--out", "-o"),
    "frontend": option(
        str,
        "psi",
        "Front end: psi, kiss_icp, open3d_icp, small_gicp, odometry, another that is installed, or a Python file with one.",
        autocompletion=_complete("mqslam.core.frontend", lambda module: module.list_front_ends()),
    ),
    "config": option(
        str | None,
        None,
        "Settings: a YAML file, or the name of one that ships with mqslam: boreas, default, lidar, mulran, oxford, "
        "radiate or rooms. By default, the layout of DATA sets range bins, stamps and direction, and psi the Doppler shift.",
        "--config",
        "-c",
        metavar="FILE|NAME",
        autocompletion=complete_config,
    ),
    "changes": option(
        list[str] | None,
        None,
        "Change one setting, such as detector.threshold=60; --set overrides --config. Repeat the option for "
        "several settings; `mqslam config show` lists them.",
        "--set",
        metavar="SECTION.NAME=VALUE",
    ),
    "odometry": option(
        str, "auto", r"Odometry: auto (the recording's own, if any), none, or a file (TUM, or CSV with t\[us],v,omega)."
    ),
    "imu": option(
        str,
        "auto",
        r"Gyroscope: auto (the recording's own, if it has one), none, or a file (CSV with t\[us],wx,wy,wz in rad/s, "
        "or one that Oxford, Boreas or MulRan has).",
    ),
    "gnss": option(
        str,
        "auto",
        "GNSS fixes: auto (the recording's own, unless its ground truth was made from them), none, or a file (NMEA, "
        r"CSV with t\[us],lat,lon in degrees and optionally sigma_m, or one that Oxford, Boreas or MulRan has).",
    ),
    "extrinsics": option(
        str,
        "auto",
        r"Where the radar sits on the vehicle: auto (as the recording states, if it does), none, or \[m] forward, "
        r"\[m] to the left, \[degrees] to the left.",
        metavar="auto|none|X,Y,YAW",
    ),
    "frame": option(
        str,
        "radar",
        "Write poses of the radar or of the vehicle, in the frame of the first pose; vehicle needs --extrinsics, unless "
        "DATA states them.",
        metavar="radar|vehicle",
    ),
    "format": option(
        str | None,
        None,
        "Layout of DATA: boreas, mulran, radiate, oxford, rosbag or native; it is guessed from the path by default.",
        "--format",
        metavar="LAYOUT",
        autocompletion=_complete("mqslam.formats.recordings", lambda module: module.FORMATS),
    ),
    "range_resolution": option(float | None, None, r"Length of a range bin \[m], if DATA states none or a wrong one."),
    "topic": option(
        list[str] | None,
        None,
        "Topic of the radar in a bag, if its type and name do not show it; odometry=TOPIC and truth=TOPIC name "
        "the topics of odometry and ground truth. Repeat the option for several topics.",
        "--topic",
        metavar="TOPIC",
    ),
    "start_s": option(
        float | None,
        None,
        "Leave out scans that begin before this time since the start of DATA.",
        "--start",
        metavar="SECONDS",
    ),
    "end_s": option(
        float | None,
        None,
        "Leave out scans that begin at or after this time since the start of DATA.",
        "--end",
        metavar="SECONDS",
    ),
    "strict": flag(
        "Stop at any fault of a radar's recording, such as a scan that cannot be read or stamps that run backward, instead "
        "of warning of it.",
        "--strict",
    ),
    "fail_on": option(
        str | None,
        None,
        "Exit with 1 if the verdict is this or worse, and with 3 if the map could not be judged.",
        metavar="|".join(_FAIL_ON),
        callback=_check_fail_on,
        autocompletion=lambda incomplete: [word for word in _FAIL_ON if word.startswith(incomplete)],
    ),
    "resume": flag("Continue the unfinished work at --out, if there is any.", "--resume"),
    "tolerance": option(
        float | None,
        None,
        r"How far two passes of a good map may be apart \[m], 0.5 for a radar by default; all other tolerances of the "
        "verdict (in metres and degrees) follow in proportion.",
        metavar="METRES",
    ),
    "force": flag("Replace a file at --out, or results in a folder at --out; other files in the folder stay.", "--force"),
    "jobs": option(
        int, os.cpu_count() or 1, "Number of processes to use, which does not change the result.", "--jobs", "-j", min=1
    ),
    "cluster": option(
        str | None,
        None,
        "Work on a Dask cluster instead: tcp://host:port, or local:N for N worker processes on this machine.",
        "--cluster",
        metavar="ADDRESS",
    ),
    "as_json": flag("Print the results as JSON.", "--json"),
    "quiet": flag("Print errors only.", "--quiet", "-q"),
    "verbose": option(
        bool, False, "Log on stderr what each stage found and how long it took.", "--verbose", "-v", callback=set_verbosity
    ),
}
"""The options that several commands share."""
for _panel, _names in _PANELS.items():
    for _name in _names.split():
        OPTIONS[_name][1].rich_help_panel = _panel
