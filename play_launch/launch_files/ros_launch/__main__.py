"""Evaluates one launch file for `evaluate`: a job as JSON in the arguments, the answer on stdout.

What the launch file prints goes to stderr. The process ends at once after the answer, whatever
threads the launch file has left.
"""

from __future__ import annotations

import gc
import os
import sys
from contextlib import suppress
from typing import Final

import msgspec

from play_launch.launch_files.records import Description, Failure, Origin, Place, encode
from play_launch.launch_files.ros_launch.driver import evaluate
from play_launch.launch_files.ros_launch.job import SIZE, Job, bound_memory

_OBJECTS: Final = 50_000
"""How many are made until garbage is looked for."""


def main() -> None:
    """Answer, and end."""
    descriptor, own = os.dup(1), os.getpid()
    os.dup2(2, 1)
    job = msgspec.json.decode(sys.argv[1], type=Job)
    bound_memory()
    # Most of what is made stays: looking for garbage as often as usual takes a tenth of the time.
    gc.set_threshold(_OBJECTS)
    # Nothing in the launch file shall take these for its own.
    sys.argv[1:] = []

    def answer(found: Description | Failure) -> None:
        if os.getpid() != own:
            # The launch file has forked, and this process is the copy.
            os._exit(0)
        try:
            records = encode(found)
        except UnicodeEncodeError as error:
            place = Origin(Place(job.path))
            text = error.object[error.start : error.end + 20]
            records = encode(Failure(f"it holds what is not UTF-8: {text!a}", place))
        # Before the answer, after which this process may be killed. The launch file may have closed
        # them, or put something else in their place.
        for stream in (sys.stdout, sys.stderr):
            with suppress(Exception):
                stream.flush()
        content = SIZE.pack(len(records)) + records
        while content:
            content = content[os.write(descriptor, content) :]

    evaluate(job, answer)
    os._exit(0)


main()
