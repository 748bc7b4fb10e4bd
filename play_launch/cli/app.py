"""The command ``play-launch``.

Everything heavy (pydantic, rclpy, rich's tables) is imported by the verbs when they run, so that
``--help`` and mistakes on the command line answer at once.
"""

from __future__ import annotations

import signal
import sys
from typing import Annotated

if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    # Until the run takes its signals, Ctrl-C just ends the process. A KeyboardInterrupt in the
    # middle of an import can be swallowed there, and would leave a traceback at best.
    signal.signal(signal.SIGINT, signal.SIG_DFL)

import typer

from play_launch.cli.check import check
from play_launch.cli.daemon import daemon_app
from play_launch.cli.doctor import doctor
from play_launch.cli.graph_commands import add_graph_commands
from play_launch.cli.replay import replay
from play_launch.cli.version import print_version, version

# \b keeps the lines of a paragraph as they are.
_EPILOG = """\b
Examples:
  play-launch check robot.yaml                   find mistakes, start nothing
  play-launch replay robot.yaml                  bring it up; Ctrl-C stops it
  play-launch replay robot.yaml --duration 30s   ... stop it after 30 s
  play-launch replay robot.yaml --json | jq .    events for programs

\b
Exit codes:
  0      everything was up
  1      a node failed
  2      wrong usage or configuration; nothing was started
  3      ended with nodes missing
  128+n  ended by signal n (130 after Ctrl-C)
"""

app = typer.Typer(
    name="play-launch",
    help="Bring up a whole ROS 2 system from one YAML file, and record what happens.",
    epilog=_EPILOG,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    # Plain help: it is wrapped to the terminal's width, and comes up twice as fast.
    rich_markup_mode=None,
    add_completion=False,
    # A traceback is for mistakes of ours only, and then Python's own form is the useful one.
    pretty_exceptions_enable=False,
)
app.command()(replay)
app.command()(check)
app.command()(doctor)
app.command()(version)
app.add_typer(daemon_app)
add_graph_commands(app)


def _version_option(asked: bool) -> None:
    if asked:
        print_version(as_json=False)
        raise typer.Exit


@app.callback()
def _options(
    _version: Annotated[
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
