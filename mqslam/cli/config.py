"""`mqslam config`: shows settings with their descriptions, the settings that a file changes, and their JSON schema."""

from __future__ import annotations

import json

import typer

from mqslam.cli.options import Command, Group, Options, argument, command, complete_config, flag
from mqslam.cli.terminal import Terminal, echo

config = typer.Typer(cls=Group, help="Show the settings, what a file changes, and the JSON schema.", no_args_is_help=True)


_SHOW: Options = {
    "name": argument(
        str | None, None, "NAME", "A YAML file, or the name of one that ships with mqslam.", autocompletion=complete_config
    ),
    "everything": flag("Also show the settings that only an expert would touch.", "--all"),
}
_DIFF: Options = {
    "name": argument(
        str, ..., "NAME", "A YAML file, such as a run's config.yaml, or the name of one that ships with mqslam."
    ),
    "other": argument(str | None, None, "OTHER", "The settings to compare NAME with."),
    "everything": flag("Also list the settings that a lidar's run has taken from its recording.", "--all"),
}


@config.command(cls=Command)
@command("name everything as_json", _SHOW)
def show(terminal: Terminal, *, name: str | None, everything: bool) -> None:
    """Show the settings of a file, or the defaults, as YAML with a description and the unit of each setting.

    Settings that only an expert would touch are shown if --all or --json is given, or if the file changes them. The YAML can
    be given to --config.

    Example: mqslam config show oxford > mine.yaml
    """
    from mqslam.config import explain_yaml, load_config

    settings = load_config(name)
    if terminal.as_json:
        typer.echo(json.dumps(settings.model_dump(mode="json"), indent=1))
    else:
        echo(explain_yaml(settings, everything=everything), end="")


@config.command(cls=Command)
@command("name other everything as_json", _DIFF)
def diff(terminal: Terminal, *, name: str, other: str | None, everything: bool) -> None:
    """Show which settings of a file differ from the defaults, or from the settings of another file.

    On the left of each arrow is the default value or, if OTHER is given, the value in NAME. A lidar's run takes many
    settings, such as lengths, from its recording. These settings are listed only with --all or --json.

    Example: mqslam config diff result/config.yaml
    """
    from mqslam.commands.lidar_settings import sort_changes
    from mqslam.config import load_config
    from mqslam.core.units import LIDAR_CONFIG
    from mqslam.core.wording import count_of

    first, second = (None, name) if other is None else (name, other)
    changes = sort_changes(load_config(first), load_config(second))
    if terminal.as_json:
        listed = [*changes.own, *changes.followed]
        typer.echo(json.dumps({key: {"from": before, "to": after} for key, before, after in listed}, indent=1))
        return
    for key, before, after in changes.own:
        typer.echo(f"{key}: {json.dumps(before)} -> {json.dumps(after)}")
    if changes.unit_m is None:
        if not changes.own:
            typer.echo("the same")
        return
    number = count_of(len(changes.followed), "more setting")
    hint = "" if everything else "; --all lists them"
    typer.echo(f"fitted to a lidar: {number} (lengths times {changes.unit_m:g}, or as in {LIDAR_CONFIG}.yaml){hint}")
    for key, before, after in changes.followed if everything else ():
        typer.echo(f"{key}: {json.dumps(before)} -> {json.dumps(after)}")


@config.command(cls=Command)
def schema() -> None:
    """Print the JSON schema of the settings, which editors use to complete and check a YAML file.

    Example: mqslam config schema > mqslam.schema.json
    """
    from mqslam.config import Config

    typer.echo(json.dumps(Config.model_json_schema(), indent=1))
