"""Entry point of the command ``play-launch``."""

from __future__ import annotations

import errno
import gc
import os
import signal
import sys
from typing import Final

OUTPUT_FAILED: Final = 2
"""Exit code if the output could not be written."""
_SHORT: Final = frozenset({"check", "dump", "ps"})


def main() -> None:
    """Run the command.

    Until a run takes its signals, Ctrl-C ends the process at once: a KeyboardInterrupt in the
    middle of an import can be swallowed there, and would leave a traceback at best.
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
            # A name on the command line that cannot even be inspected.
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
    # Of what is imported and of a configuration nothing becomes garbage: collecting takes a
    # twentieth of the start. `app` and a run enable it again.
    gc.disable()
    from play_launch.cli.app import main as run  # noqa: PLC0415 - after the lines above

    try:
        run()
    except SystemExit as end:
        if isinstance(end.code, int) and len(sys.argv) > 1 and sys.argv[1] in _SHORT:
            # Taking Python apart takes up to 30 ms, a fifth of a short command.
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(end.code)
        raise
