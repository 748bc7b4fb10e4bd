"""Puts the verbs of ``graph.py`` into the command's help; they parse their own options."""

from __future__ import annotations

import typer

from play_launch.cli.graph import GROUPS, main

_UNPARSED = {"ignore_unknown_options": True, "allow_extra_args": True, "help_option_names": []}


def graph_command(group: str) -> typer.Typer:
    """Make the command ``node``, ``topic``, ``service`` or ``graph``."""
    made = typer.Typer(add_completion=False, rich_markup_mode=None)
    made.command(group, help=GROUPS[group], context_settings=_UNPARSED, add_help_option=False)(_run)
    return made


def _run(context: typer.Context) -> None:
    raise typer.Exit(main([str(context.info_name), *context.args]))
