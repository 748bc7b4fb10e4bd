"""Evaluates a launch file in XML or YAML."""

from __future__ import annotations

import math
import os
import time
from typing import TYPE_CHECKING

from play_launch.launch_files.markup.actions import include_file, visit
from play_launch.launch_files.markup.context import beginning
from play_launch.launch_files.markup.trouble import Trouble
from play_launch.launch_files.records import Failure, LaunchFileError, Origin, Place

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from play_launch.launch_files.markup.context import Context
    from play_launch.launch_files.records import Description


def evaluate(
    path: Path,
    arguments: Mapping[str, str],
    environ: Mapping[str, str] | None = None,
    *,
    limit: float = math.inf,
    only_arguments: bool = False,
) -> Description:
    """Return what a launch file describes; programs of `$(command ...)` are run, nothing else is.

    `limit` is the seconds that all of it may take; with 0 it may take long, but no program is run.
    With `only_arguments`, what needs an argument that is not given is passed over.

    Raises:
        LaunchFileError: For the first mistake, with file, line and the chain of includes.
    """
    file = os.path.abspath(path)  # noqa: PTH100 - links stay as they are
    context = beginning(arguments, file, environ)
    context.only_arguments = only_arguments
    context.limit, context.deadline = limit, time.monotonic() + limit
    try:
        include_file(file, context)
        # Timers, in the order in which they fire: their scopes have ended.
        while context.deferred:
            delays = [sum(each.seconds for each in timer.start) for timer in context.deferred]
            waiting = context.deferred.pop(delays.index(min(delays)))
            context.chain, context.start = waiting.chain, waiting.start
            context.file, context.directory = waiting.file, waiting.directory
            for entity in waiting.entities:
                visit(entity, context)
    except Trouble as trouble:
        origin = Origin(trouble.place or Place(file), _chain(context))
        raise LaunchFileError(Failure(str(trouble), origin)) from trouble
    except RecursionError as error:
        failure = Failure("nested too deeply", Origin(Place(context.file), _chain(context)))
        raise LaunchFileError(failure) from error
    context.description.losses = list(context.losses)
    return context.description


def _chain(context: Context) -> tuple[Place, ...]:
    # What includes itself is named once.
    return tuple(dict.fromkeys(context.chain))
