"""What the command ``play-launch`` runs first."""

from __future__ import annotations

import errno
import gc
import os
import signal
import sys

OUTPUT_FAILED = 2
"""The exit code when what was asked for could not be written."""


def main() -> None:
    """Run the command.

    Until a run takes its signals, Ctrl-C just ends the process: a KeyboardInterrupt in the middle
    of an import can be swallowed there, and would leave a traceback at best.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from play_launch.cli.output import (  # noqa: PLC0415 - after the lines above
        is_about_output,
        prepare_standard_streams,
        report_write_error,
    )

    prepare_standard_streams()
    try:
        _run()
    except OSError as error:
        if is_about_output(error):
            report_write_error(error)
        elif error.filename and error.errno in {errno.EACCES, errno.ENAMETOOLONG}:
            # A name on the command line that cannot even be looked at.
            from play_launch.cli.output import fail  # noqa: PLC0415 - rarely needed

            fail(f"{os.fsdecode(error.filename)}: {error.strerror}")
        elif isinstance(error, FileNotFoundError) and _folder_is_gone():
            from play_launch.cli.output import fail  # noqa: PLC0415 - rarely needed

            fail("the working directory was removed; change to another one")
        else:
            raise
        sys.exit(OUTPUT_FAILED)


def _folder_is_gone() -> bool:
    try:
        os.getcwd()  # noqa: PTH109 - pathlib is slow to import
    except FileNotFoundError:
        return True
    return False


def _run() -> None:
    from play_launch.cli.session_verbs import SESSION_VERBS  # noqa: PLC0415 - as above

    if len(sys.argv) > 1 and sys.argv[1] in {"node", "topic", "service"}:
        # Past typer and all that comes with it: these are done before it would be imported.
        from play_launch.cli.graph import main as ask  # noqa: PLC0415 - not for other verbs

        sys.exit(ask(sys.argv[1:]))
    if len(sys.argv) > 1 and sys.argv[1] in SESSION_VERBS:
        # As above: they are asked again and again.
        from play_launch.cli.operate import main as operate  # noqa: PLC0415 - as above

        sys.exit(operate(sys.argv[1:]))
    if sys.argv[1:3] == ["completion", "--answer"] and len(sys.argv) > 4:
        # As above: at each press of a key.
        from play_launch.cli.completion.answer import main as answer  # noqa: PLC0415 - as above

        sys.exit(answer(sys.argv[3:]))
    from play_launch.cli.shortcut import run_plainly  # noqa: PLC0415 - after the lines above

    # Of what is imported and of a configuration nothing becomes garbage: looking for it again and
    # again takes a twentieth of the start. A run looks again from when it begins.
    gc.disable()
    code = run_plainly(sys.argv[1:])
    if code is not None:
        _end(code)
    gc.enable()
    from play_launch.cli.app import main as run  # noqa: PLC0415

    run()


def _end(code: int) -> None:
    """End with that exit code, and where nothing runs any more, without taking Python apart.

    That takes up to 30 ms, a fifth of a short command.
    """
    if sys.argv[1] in {"check", "dump"}:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)
