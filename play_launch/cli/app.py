"""The command ``play-launch``: all its commands, each imported when it is called."""

from __future__ import annotations

import gc
import os
import sys
from importlib import import_module
from typing import TYPE_CHECKING, Annotated, Any, Final, NamedTuple, NoReturn

import typer
from typer.core import TyperCommand, TyperGroup

from play_launch import UserError
from play_launch.cli.options import PLAIN
from play_launch.cli.output import fail, note
from play_launch.config.text import similar

if TYPE_CHECKING:
    from collections.abc import Callable

# \b keeps the lines of a paragraph as they are.
_EPILOG = """\b
Examples:
  play-launch check robot.yaml                   find mistakes; start nothing
  play-launch replay robot.yaml                  start it; Ctrl-C stops it
  play-launch replay robot.yaml --duration 30s   stop it after 30 s
  play-launch replay robot.yaml --json | jq .    print events as JSON
  play-launch launch PKG FILE name:=value        start a launch file of ROS
  play-launch dump PKG FILE -o robot.yaml        convert a launch file

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


class Verb(NamedTuple):
    """A command: a function or a `Typer` in a module of `play_launch.cli`."""

    name: str
    group: str
    """Heading in the help."""
    help: str
    shared_module: str = ""
    """The module, if it is not named like the command."""

    @property
    def function(self) -> str:
        """Name of the function, and of its module: dashes are underscores."""
        return "import_" if self.name == "import" else self.name.replace("-", "_")

    @property
    def module(self) -> str:
        return self.shared_module or self.function


_START, CONTROL = "Configure and start", "Control a running session"
_ANALYSE, _GRAPH, _SETUP = "Analyse recordings", "ROS graph", "Installation"
# In the order of the help.
_ALL: Final = (
    Verb("replay", _START, "Start a system and record it."),
    Verb("launch", _START, "Start a ROS launch file and record it."),
    Verb("dump", _START, "Convert a ROS launch file to a configuration."),
    Verb("check", _START, "Check a configuration; start nothing."),
    Verb("init", _START, "Write a configuration to begin with."),
    Verb("schema", _START, "Print the JSON Schema of configurations.", "init"),
    Verb("import", _START, "Convert a dump of play_launch (Rust)."),
    Verb("systemd-unit", _START, "Write a systemd unit."),
    Verb("kubernetes", _START, "Write Kubernetes manifests."),
    Verb("demo", _START, "Start the demo system: eight nodes, 10 s."),
    Verb("ps", CONTROL, "List containers, nodes and processes."),
    Verb("status", CONTROL, "Show all about one container, node or process."),
    Verb("top", CONTROL, "Watch and operate a session on a screen."),
    Verb("web", CONTROL, "Show a session in a browser."),
    Verb("events", CONTROL, "Print events; with -f new ones, too."),
    Verb("logs", CONTROL, "Print output of nodes; with -f new lines, too.", "events"),
    Verb("wait", CONTROL, "Wait until a system is up."),
    Verb("start", CONTROL, "Start stopped containers or processes.", "operate"),
    Verb("stop", CONTROL, "Stop containers or processes.", "operate"),
    Verb("restart", CONTROL, "Restart containers or processes.", "operate"),
    Verb("load", CONTROL, "Load composable nodes that are not loaded.", "operate"),
    Verb("unload", CONTROL, "Unload composable nodes.", "operate"),
    Verb("reload", CONTROL, "Unload composable nodes and load them again.", "operate"),
    Verb("signal", CONTROL, "Send a signal to processes.", "operate"),
    Verb("shutdown", CONTROL, "End a session in order.", "operate"),
    Verb("diff", CONTROL, "Compare a session with a configuration.", "apply"),
    Verb("apply", CONTROL, "Change a session to match a configuration."),
    Verb("param", CONTROL, "Get, set and dump parameters of nodes."),
    Verb("snapshot", CONTROL, "Write the pre-crash buffer (record.before_crash).", "operate"),
    Verb("expect", CONTROL, "Compare topics with what is expected of them."),
    Verb("diagnostics", CONTROL, "Publish the states of all units on /diagnostics."),
    Verb("info", _ANALYSE, "Summarise a recording."),
    Verb("inspect", _ANALYSE, "Print the events of a recording."),
    Verb("report", _ANALYSE, "Write an HTML page about a recording."),
    Verb("explain", _ANALYSE, "Explain what went wrong in a session."),
    Verb("crashes", _ANALYSE, "Group the crashes of many sessions."),
    Verb("compare", _ANALYSE, "Compare two sessions."),
    Verb("rerun", _ANALYSE, "Repeat and compare the supervisor's decisions."),
    Verb("collect", _ANALYSE, "Fetch and merge the recordings of all machines."),
    Verb("recover", _ANALYSE, "Repair a damaged or unfinished recording."),
    Verb("export", _ANALYSE, "Convert a recording to Perfetto, CSV or Parquet."),
    Verb("layout", _ANALYSE, "Print a layout for Foxglove or PlotJuggler."),
    Verb("node", _GRAPH, "List nodes; show one."),
    Verb("topic", _GRAPH, "List topics.", "node"),
    Verb("service", _GRAPH, "List services.", "node"),
    Verb("graph", _GRAPH, "Check the connections."),
    Verb("daemon", _GRAPH, "Run the graph daemon in place of ros2cli's."),
    Verb("doctor", _SETUP, "Check this machine, with fixes."),
    Verb("completion", _SETUP, "Print the completion script of a shell."),
    Verb("manual", _SETUP, "Print the help of all commands."),
    Verb("version", _SETUP, "Print versions.", "doctor"),
)
COMMANDS: Final = {each.name: each for each in _ALL}


def command_of(command: Verb) -> Any:
    """Import a command and build its parser."""
    found = getattr(import_module(f"play_launch.cli.{command.module}"), command.function)
    if not isinstance(found, typer.Typer):
        function: Callable[..., Any] = found
        found = typer.Typer(**PLAIN)
        found.command(command.name)(function)
    return typer.main.get_command(found)


_UsageError: Any = typer.BadParameter.__base__


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
            close = similar(args[0], COMMANDS)
            ctx.fail(
                f"No such command {args[0]!r}." + (f" Did you mean {close!r}?" if close else "")
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

    def main(self, *args: Any, **extra: Any) -> NoReturn:
        """Run a command line and exit; an error has the form of all others."""
        try:
            code = super().main(*args, **{**extra, "standalone_mode": False})
        except UserError as error:
            fail(str(error), error.exit_code)
        except _UsageError as error:
            message = error.format_message()
            if message.startswith("Usage: "):  # the help, where a command is missing
                note(message)
                sys.exit(error.exit_code)
            # An option without its value has no context: its command is the first word.
            verb = [each for each in sys.argv[1:2] if each in COMMANDS]
            command = error.ctx.command_path if error.ctx else " ".join(["play-launch", *verb])
            fail(f"{message.rstrip('.')}; see '{command} --help'", error.exit_code)
        sys.exit(code or 0)

    def shell_complete(self, ctx: Any, incomplete: str) -> Any:
        self._lists = True
        return super().shell_complete(ctx, incomplete)

    def invoke(self, ctx: Any) -> None:
        """Run the command; its result is the exit code."""
        name = (*ctx._protected_args, "")[0]  # noqa: SLF001 - not yet resolved
        if name in COMMANDS and COMMANDS[name].group != _START:
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
        from play_launch.cli.doctor import version  # noqa: PLC0415 - not for other commands

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
