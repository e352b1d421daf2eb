"""`mqslam config`: shows the settings, with unit and reason."""

from __future__ import annotations

import json
from typing import Annotated

import typer

from mqslam.cli.terminal.echo import echo
from mqslam.cli.terminal.options import ConfigName, Json

config = typer.Typer(help="Show the settings, what a file changes, and their schema.", no_args_is_help=True)


@config.command()
def show(
    name: ConfigName = None,
    everything: Annotated[
        bool, typer.Option("--all", help="Also show the settings that only an expert would touch.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Show the settings of a file, or the defaults, as YAML that --config reads, each with its unit and reason.

    Settings that only an expert would touch are shown with --all, with --json, and where the file changes them.

    Example: mqslam config show oxford > mine.yaml
    """
    from mqslam.config import explain_yaml, load_config

    settings = load_config(name)
    if as_json:
        typer.echo(json.dumps(settings.model_dump(mode="json"), indent=1))
    else:
        echo(explain_yaml(settings, everything=everything), end="")


@config.command()
def diff(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME", help="A YAML file, such as a run's config.yaml, or the name of one that ships with mqslam."
        ),
    ],
    other: Annotated[
        str | None, typer.Argument(metavar="OTHER", help="The settings to compare it with; the defaults if not given.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Show which settings a file changes.

    Example: mqslam config diff result/config.yaml
    """
    from mqslam.config import list_changes, load_config

    changes = list_changes(load_config(other), load_config(name))
    if as_json:
        typer.echo(json.dumps({key: {"from": before, "to": after} for key, before, after in changes}, indent=1))
        return
    for key, before, after in changes:
        typer.echo(f"{key}: {json.dumps(before)} -> {json.dumps(after)}")


@config.command()
def schema() -> None:
    """Print the JSON schema of the settings, which editors use to complete and check a YAML file.

    Example: mqslam config schema > mqslam.schema.json
    """
    from mqslam.config import Config

    typer.echo(json.dumps(Config.model_json_schema(), indent=1))
