"""What the command ``play-launch`` runs first."""

from __future__ import annotations

import signal


def main() -> None:
    """Run the command.

    Until a run takes its signals, Ctrl-C just ends the process: a KeyboardInterrupt in the middle
    of an import can be swallowed there, and would leave a traceback at best.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from play_launch.cli.app import main as run  # noqa: PLC0415 - after the line above

    run()
