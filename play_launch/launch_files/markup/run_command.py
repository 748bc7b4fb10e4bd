"""What `$(command ...)` stands for: the output of a program, which is ended when it is done."""

from __future__ import annotations

import contextlib
import os
import selectors
import signal
import subprocess
import time
from typing import TYPE_CHECKING, Final

from play_launch.launch_files.markup.command_line import split
from play_launch.launch_files.markup.trouble import Trouble
from play_launch.launch_files.reading import LARGEST

if TYPE_CHECKING:
    from play_launch.launch_files.markup.context import Context

COMMAND_LIMIT: Final = 60.0
"""Seconds that a program may take."""
_CHUNK: Final = 1 << 16


def run_command(context: Context, arguments: list[str]) -> str:
    """Return what a program writes to stdout.

    Raises:
        Trouble: When it cannot be run, fails, or takes or writes too much.
    """
    on_stderr = arguments[1] if len(arguments) == 2 else "fail"
    if on_stderr not in ("fail", "ignore", "warn", "capture"):
        raise Trouble(f"{on_stderr} is none of fail, ignore, warn and capture")
    limit = min(COMMAND_LIMIT, context.deadline - time.monotonic())
    if limit <= 0:
        raise Trouble(f"there is no time left to run {arguments[0]!r}")
    words = split(arguments[0])
    try:
        process = subprocess.Popen(
            words,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT if on_stderr == "capture" else subprocess.PIPE,
            env=context.environment,
            start_new_session=True,
        )
    except (OSError, ValueError, IndexError) as error:
        raise Trouble(f"{arguments[0]!r} cannot be run: {error}") from error
    with process:
        try:
            written, complaints = _output(process, limit, arguments[0])
        finally:
            _end(process)
    said = complaints.strip()
    if process.returncode != 0:
        raise Trouble(f"{arguments[0]!r} exited with {process.returncode}: {said[-500:]}")
    if said and on_stderr == "fail":
        raise Trouble(f"{arguments[0]!r} wrote to stderr: {said[-500:]}")
    return written


def _output(process: subprocess.Popen[bytes], limit: float, shown: str) -> tuple[str, str]:
    """Return what a program writes to stdout and to stderr until it has ended."""
    deadline = time.monotonic() + limit
    contents = [(stream, bytearray()) for stream in (process.stdout, process.stderr) if stream]
    with selectors.DefaultSelector() as selector:
        for stream, content in contents:
            selector.register(stream, selectors.EVENT_READ, content)
        while selector.get_map():
            ready = selector.select(max(0.0, deadline - time.monotonic()))
            if not ready:
                raise Trouble(f"{shown!r} takes longer than {limit:.0f} s")
            for key, _ in ready:
                chunk = os.read(key.fd, _CHUNK)
                key.data.extend(chunk)
                if not chunk:
                    selector.unregister(key.fileobj)
                elif len(key.data) > LARGEST:
                    raise Trouble(f"{shown!r} writes more than {LARGEST // 2**20} MiB")
    try:
        process.wait(max(0.0, deadline - time.monotonic()))
        texts = [_text(content) for _, content in contents]
    except subprocess.TimeoutExpired as error:
        raise Trouble(f"{shown!r} takes longer than {limit:.0f} s") from error
    except ValueError as error:
        raise Trouble(f"{shown!r} writes no UTF-8") from error
    return texts[0], texts[1] if len(texts) == 2 else ""


def _text(content: bytearray) -> str:
    # Line ends as launch has them, which reads the output as a text.
    return content.decode().replace("\r\n", "\n").replace("\r", "\n")


def _end(process: subprocess.Popen[bytes]) -> None:
    """End what is left of a program and of what it has started in its session's group."""
    with contextlib.suppress(ProcessLookupError):
        # Until it is waited for, or while others are in it, the number is that group's.
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
