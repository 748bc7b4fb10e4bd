"""The command ``play-launch``.

Everything heavy (pydantic, rclpy, rich's tables) is imported by the verbs when they run, so that
``--help`` and mistakes on the command line answer at once.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from play_launch.cli.session_verbs import SESSION_VERBS
from play_launch.cli.verbs import ABOUT_RECORDINGS, VERBS

if TYPE_CHECKING:
    from collections.abc import Callable

# \b keeps the lines of a paragraph as they are.
_EPILOG = """\b
Examples:
  play-launch check robot.yaml                   find mistakes, start nothing
  play-launch replay robot.yaml                  bring it up; Ctrl-C stops it
  play-launch launch PKG FILE name:=value        bring up a launch file of ROS
  play-launch dump PKG FILE -o robot.yaml        ... write it as a configuration
  play-launch replay robot.yaml --duration 30s   ... stop it after 30 s
  play-launch replay robot.yaml --json | jq .    events for programs

\b
Exit codes:
  0      everything was up
  1      a node failed, or something crashed while it was stopped
  2      wrong usage or configuration; nothing was started
  3      ended with nodes missing
  128+n  ended by signal n (130 after Ctrl-C)
"""

_PLAIN: dict[str, Any] = {
    # Plain help: it is wrapped to the terminal's width, and comes up twice as fast.
    "rich_markup_mode": None,
    "add_completion": False,
    # A traceback is for mistakes of ours only, and then Python's own form is the useful one.
    "pretty_exceptions_enable": False,
    "context_settings": {"help_option_names": ["-h", "--help"]},
}


def _typer_of(verb: str) -> typer.Typer:
    # What the other verbs import would slow down the start of a system.
    callback: Callable[..., None]
    match verb:
        case "replay":
            from play_launch.cli.replay import replay as callback  # noqa: PLC0415
        case "launch":
            from play_launch.cli.launch import launch as callback  # noqa: PLC0415
        case "dump":
            from play_launch.cli.dump import dump as callback  # noqa: PLC0415
        case "check":
            from play_launch.cli.check import check as callback  # noqa: PLC0415
        case verb if verb in ABOUT_RECORDINGS:
            from play_launch.cli import past_sessions  # noqa: PLC0415

            callback = getattr(past_sessions, verb)
        case "import":
            from play_launch.cli.import_ import import_system as callback  # noqa: PLC0415
        case "systemd-unit":
            from play_launch.cli.systemd_unit import systemd_unit as callback  # noqa: PLC0415
        case "init":
            from play_launch.cli.init import init as callback  # noqa: PLC0415
        case "schema":
            from play_launch.cli.schema import schema as callback  # noqa: PLC0415
        case "doctor":
            from play_launch.cli.doctor import doctor as callback  # noqa: PLC0415
        case "completion":
            from play_launch.cli.completion_script import (  # noqa: PLC0415
                completion as callback,
            )
        case "version":
            from play_launch.cli.version import version as callback  # noqa: PLC0415
        case "daemon":
            from play_launch.cli.daemon import daemon_app  # noqa: PLC0415

            return daemon_app
        case verb if verb in SESSION_VERBS:
            from play_launch.cli.operate import main as operate  # noqa: PLC0415
            from play_launch.cli.passed_on import passed_on  # noqa: PLC0415

            return passed_on(verb, SESSION_VERBS[verb][1], operate)
        case _:
            from play_launch.cli import graph  # noqa: PLC0415
            from play_launch.cli.passed_on import passed_on  # noqa: PLC0415

            return passed_on(verb, graph.GROUPS[verb], graph.main)
    made = typer.Typer(**_PLAIN)
    made.command()(callback)
    return made


def command_of(verb: str) -> Any:
    """Give the command of a verb, as typer makes it."""
    return typer.main.get_command(_typer_of(verb))


class _Verbs(TyperGroup):
    """Imports a verb when it is asked for."""

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ARG002 - typer's signature
        return list(VERBS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if cmd_name not in VERBS:
            # The error proposes a similar one of `commands`.
            for verb in VERBS:
                self.get_command(ctx, verb)
        elif cmd_name not in self.commands:
            self.commands[cmd_name] = command_of(cmd_name)
        return self.commands.get(cmd_name)


app = typer.Typer(
    name="play-launch",
    cls=_Verbs,
    help="Bring up a whole ROS 2 system from one YAML file, and record what happens.",
    epilog=_EPILOG,
    no_args_is_help=True,
    **_PLAIN,
)


def _version_option(asked: bool) -> None:
    if asked:
        from play_launch.cli.version import print_version  # noqa: PLC0415

        print_version(as_json=False)
        raise typer.Exit


@app.callback()
def _options(
    _asked: Annotated[
        bool,
        typer.Option(
            "--version", callback=_version_option, is_eager=True, help="Print versions and exit."
        ),
    ] = False,
) -> None:
    pass


def main() -> None:
    """Run the command and end the process with its exit code."""
    try:
        app(prog_name="play-launch")
    except KeyboardInterrupt:
        # Before or after the run; during it, the signal is a request to stop.
        sys.exit(130)
