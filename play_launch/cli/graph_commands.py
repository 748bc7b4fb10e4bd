"""Puts the verbs of ``graph.py`` into the command's help; they parse their own options."""

from __future__ import annotations

import typer

from play_launch.cli.graph import GROUPS, main

_UNPARSED = {"ignore_unknown_options": True, "allow_extra_args": True, "help_option_names": []}


def add_graph_commands(app: typer.Typer) -> None:
    """Add ``node``, ``topic``, ``service`` and ``graph`` to ``app``."""
    for group, text in GROUPS.items():
        app.command(group, help=text, context_settings=_UNPARSED, add_help_option=False)(_run)


def _run(context: typer.Context) -> None:
    raise typer.Exit(main([str(context.info_name), *context.args]))
