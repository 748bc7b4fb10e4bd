"""The command ``play-launch``: commands are imported when they are called."""

from __future__ import annotations

import gc
import os
from importlib import import_module
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from play_launch.cli.commands import COMMANDS, Command, Needs
from play_launch.cli.options import PLAIN

if TYPE_CHECKING:
    from collections.abc import Callable

# \b keeps the lines of a paragraph as they are.
_EPILOG = """\b
Examples:
  play-launch check robot.yaml                   find mistakes, start nothing
  play-launch replay robot.yaml                  start it; Ctrl-C stops it
  play-launch launch PKG FILE name:=value        start a launch file of ROS
  play-launch dump PKG FILE -o robot.yaml        ... write it as a configuration
  play-launch replay robot.yaml --duration 30s   ... stop it after 30 s
  play-launch replay robot.yaml --json | jq .    events as JSON

\b
Exit codes:
  0      success
  1      failure: a node failed, or a request was refused
  2      wrong usage or configuration; nothing was started
  3      the run ended while something was not running
  4      timeout
  5      a recording could not be read completely
  128+n  ended by signal n (130 after Ctrl-C)
"""


def command_of(command: Command) -> Any:
    """Import a command and build its parser."""
    found = getattr(import_module(f"play_launch.cli.{command.module}"), command.function)
    if not isinstance(found, typer.Typer):
        function: Callable[..., Any] = found
        found = typer.Typer(**PLAIN)
        found.command(command.name)(function)
    return typer.main.get_command(found)


class _Commands(TyperGroup):
    _lists = False

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ARG002 - typer's signature
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:  # noqa: ARG002 - as above
        command = COMMANDS.get(cmd_name)
        if command is None:
            return None
        if self._lists:  # no module is imported for a name
            return TyperCommand(cmd_name, help=command.help)
        if cmd_name not in self.commands:
            self.commands[cmd_name] = command_of(command)
        return self.commands[cmd_name]

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        if args[0] not in COMMANDS and not ctx.resilient_parsing:
            from difflib import get_close_matches  # noqa: PLC0415 - for an error only

            similar = get_close_matches(args[0], COMMANDS, 1)
            ctx.fail(
                f"No such command {args[0]!r}."
                + (f" Did you mean {similar[0]!r}?" if similar else "")
            )
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:  # noqa: ARG002 - as above
        width = max(map(len, COMMANDS))
        for group in dict.fromkeys(each.group for each in COMMANDS.values()):
            with formatter.section(group):
                formatter.write_dl(
                    [
                        (each.name.ljust(width), each.help)
                        for each in COMMANDS.values()
                        if each.group == group
                    ]
                )

    def shell_complete(self, ctx: Any, incomplete: str) -> Any:
        self._lists = True
        return super().shell_complete(ctx, incomplete)

    def invoke(self, ctx: Any) -> None:
        """Run the command; its result is the exit code."""
        name = (*ctx._protected_args, "")[0]  # noqa: SLF001 - not yet resolved
        if name in COMMANDS and COMMANDS[name].needs is not Needs.CONFIGURATION:
            gc.enable()  # see `entry`
        raise typer.Exit(super().invoke(ctx) or 0)


app = typer.Typer(
    name="play-launch",
    cls=_Commands,
    help="Start a whole ROS 2 system from one YAML file, and record what happens.",
    epilog=_EPILOG,
    no_args_is_help=True,
    **PLAIN,
)


def _print_version(is_given: bool) -> None:
    if is_given:
        from play_launch.cli.version import version  # noqa: PLC0415 - not for other commands

        version()
        raise typer.Exit


@app.callback()
def _options(
    _version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Print versions and exit."
        ),
    ] = False,
) -> None:
    pass


def main() -> None:
    """Run the command and end the process with its exit code."""
    if "_PLAY_LAUNCH_COMPLETE" in os.environ:
        from typer import completion  # noqa: PLC0415 - at Tab only

        completion.completion_init()  # type: ignore[attr-defined]
    app(prog_name="play-launch")
