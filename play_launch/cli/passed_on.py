"""Puts verbs that parse their own options into the command's help: those of `graph`, `operate`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

_UNPARSED = {"ignore_unknown_options": True, "allow_extra_args": True, "help_option_names": []}


def passed_on(verb: str, about: str, main: Callable[[Sequence[str]], int]) -> typer.Typer:
    """Make a command of ``main``, which takes the verb and all that follows it."""

    def run(context: typer.Context) -> None:
        raise typer.Exit(main([verb, *context.args]))

    made = typer.Typer(add_completion=False, rich_markup_mode=None)
    made.command(verb, help=about, context_settings=_UNPARSED, add_help_option=False)(run)
    return made
