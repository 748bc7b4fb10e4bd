"""Evaluates a launch file in a process of its own, of which nothing is left afterwards.

The guard of sessions is its parent: it ends everything that the launch file has started, also when
this process is killed.
"""

from __future__ import annotations

import asyncio
import os
import sys
import tempfile
import time
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Final

import msgspec

from play_launch.config.substitutions import ament_prefixes
from play_launch.container.ros import spawn_guard
from play_launch.launch_files.records import (
    Description,
    EvaluationFailure,
    Job,
    LaunchFileError,
    LaunchOrigin,
    Place,
)
from play_launch.process.guard import SessionGuard

if TYPE_CHECKING:
    from collections.abc import Mapping

    from play_launch.process.exit import Exit

_GRACE: Final = 15.0
"""Seconds beyond the limit in which the process may import launch, and say where it hangs."""
_POLL: Final = 0.01
_MODULE: Final = "play_launch.launch_files.ros_launch"


def missing_package() -> str:
    """Return the package that evaluates launch files and is not installed; empty: all are."""
    # `launch` on PyPI is something else.
    return next((name for name in ("launch_ros", "launch") if find_spec(name) is None), "")


def evaluate(
    path: Path,
    arguments: Mapping[str, str],
    *,
    limit: float,
    only_arguments: bool = False,
    is_faster: bool = True,
) -> Description:
    """Return what a launch file describes; its output goes to stderr. Blocks.

    Args:
        path: The launch file.
        arguments: The launch arguments.
        limit: Seconds that it may take.
        only_arguments: Read only which arguments it declares.
        is_faster: Leave out what launch does needlessly often; the answer is the same.

    Raises:
        LaunchFileError: When it cannot be evaluated, or ROS's launch is missing.
        NotInstalledError: When our own programs are missing.
        OSError: When no process can be started.
    """
    if package := missing_package():
        what = f"{package}, which evaluates launch files, is not installed here"
        fix = "source a ROS with launch_ros, or run `play-launch dump` where it is"
        raise LaunchFileError(f"{path}: {what}; {fix}")
    prefix = "play_launch_evaluation_"
    with tempfile.TemporaryDirectory(prefix=prefix, ignore_cleanup_errors=True) as temporary:
        job = Job(
            path=str(path.absolute()),
            arguments=tuple(arguments.items()),
            temporary=f"{temporary}/files",
            answer=f"{temporary}/answer",
            limit=limit,
            is_faster=is_faster,
            only_arguments=only_arguments,
        )
        try:
            text = msgspec.json.encode(job).decode()
        except UnicodeEncodeError:
            what = "its path or arguments are not UTF-8"
            raise LaunchFileError(f"{job.path!a}: {what}") from None
        os.mkdir(job.temporary)  # noqa: PTH102
        found = asyncio.run(_run(job, text))
    if isinstance(found, EvaluationFailure):
        raise LaunchFileError(str(found))
    return found


async def _run(job: Job, text: str) -> Description | EvaluationFailure:
    guard = SessionGuard.start(spawn_guard())
    try:
        # -P: a folder `launch` in the working directory is not what is imported.
        argv = [sys.executable, "-P", "-m", _MODULE, text]
        with open(os.devnull, "rb") as nothing:  # noqa: ASYNC230, PTH123
            # What the launch file prints is no result.
            streams = {0: nothing.fileno(), 1: 2, 2: 2}
            pid = await guard.spawn(argv, _environment(), streams, leaves_by_itself=False)
        if not job.only_arguments:
            # What the answer is written with, while the other process imports launch.
            import play_launch.launch_files.configuration.write  # noqa: F401, PLC0415
        ended = await _end(guard, pid, job.limit + _GRACE)
        with suppress(OSError, msgspec.MsgspecError):
            content = Path(job.answer).read_bytes()  # noqa: ASYNC240
            return msgspec.msgpack.decode(content, type=Description | EvaluationFailure)
    finally:
        guard.close()
    what = f"its evaluation gave no result within {job.limit:g} s"
    if ended is not None:
        what = f"it ends its own evaluation: {ended}"
    return EvaluationFailure(what, LaunchOrigin(Place(job.path)))


def _environment() -> dict[str, str]:
    """Return ours, in which ROS finds the packages that what is started will find."""
    prefixes = dict.fromkeys([Path(sys.prefix), *ament_prefixes(os.environ)])
    return {**os.environ, "AMENT_PREFIX_PATH": os.pathsep.join(map(str, prefixes))}


async def _end(guard: SessionGuard, pid: int, limit: float) -> Exit | None:
    """Return how the process exited; None when it takes longer than the limit."""
    deadline = time.monotonic() + limit
    while (found := await guard.ended(pid)) is None and time.monotonic() < deadline:  # noqa: ASYNC110
        await asyncio.sleep(_POLL)
    return found
