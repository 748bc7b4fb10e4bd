"""Evaluates one launch file for `evaluate`: a job as JSON in the arguments, the answer in a file.

The process ends at once after the answer, whatever threads the launch file has left.
"""

from __future__ import annotations

import asyncio
import gc
import importlib.util
import logging
import os
import signal
import sys
import tempfile
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import msgspec

from play_launch.container.ros import log_folder
from play_launch.launch_files.records import (
    Description,
    EvaluationFailure,
    Job,
    LaunchOrigin,
    Place,
)
from play_launch.launch_files.ros_launch.places import Places, reason_of, trail

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType

_OBJECTS: Final = 50_000
"""How many are made until garbage is looked for."""
_USER: Final = "launch.user"
"""The logger of what launch files say themselves."""
_NO_DESCRIPTION: Final = '(description: "no description given")'
_PACKAGES: Final = ("launch", "launch_ros", "launch_xml", "launch_yaml", "osrf_pycommon")


def main() -> None:
    job = msgspec.json.decode(sys.argv[1], type=Job)
    # Most of what is made stays: looking for garbage as often as usual takes a tenth of the time.
    gc.set_threshold(_OBJECTS)
    # Nothing in the launch file shall take these for its own.
    sys.argv[1:] = []

    def answer(found: Description | EvaluationFailure) -> None:
        try:
            records = msgspec.msgpack.encode(found)
        except UnicodeEncodeError as error:
            text = error.object[error.start : error.end + 20]
            what = f"it holds what is not UTF-8: {text!a}"
            records = msgspec.msgpack.encode(EvaluationFailure(what, LaunchOrigin(Place(job.path))))
        for stream in (sys.stdout, sys.stderr):
            with suppress(Exception):
                stream.flush()
        Path(job.answer).write_bytes(records)

    _answer(job, answer)
    os._exit(0)


def _answer(job: Job, answer: Callable[[Description | EvaluationFailure], None]) -> None:
    """Evaluate, and call `answer` once; with a failure also out of the middle when time is up."""
    places = Places(_library_folders())
    held = HeldErrors()
    # The files of RewrittenYaml, of launch_ros and others; the variable TMPDIR would be inherited.
    tempfile.tempdir = job.temporary
    try:
        alarm = partial(_set_alarm, job.limit, places, answer)
        found: Description | EvaluationFailure = _description(job, places, held, alarm)
        held.release()
    except (Exception, SystemExit, KeyboardInterrupt) as error:  # noqa: BLE001 - the user's code
        found = _failure(places, error, held)
    signal.setitimer(signal.ITIMER_REAL, 0)
    answer(found)


def _library_folders() -> tuple[str, ...]:
    """Return the folders whose code is never where a part of a launch file stands."""
    found = [str(Path(os.__file__).parent), str(Path(__file__).parents[2])]
    for name in _PACKAGES:
        spec = importlib.util.find_spec(name)
        found += list(spec.submodule_search_locations or ()) if spec else []
    return tuple(found)


def _set_alarm(
    limit: float, places: Places, answer: Callable[[Description | EvaluationFailure], None]
) -> None:
    def on_alarm(_: int, frame: FrameType | None) -> None:
        place = places.of_frames(frame)
        origin = places.origin(place) if place.file in places.files else places.of_visited()
        answer(EvaluationFailure(f"it is not evaluated after {limit:g} s", origin))
        # Whatever it hangs in may swallow an exception.
        os._exit(0)

    signal.signal(signal.SIGALRM, on_alarm)
    signal.setitimer(signal.ITIMER_REAL, limit)


def _failure(places: Places, error: BaseException, held: HeldErrors) -> EvaluationFailure:
    errors = trail(error)
    message, place = reason_of(errors[0], places)
    return EvaluationFailure(message, places.of_error(errors, place), held.texts(message))


class HeldErrors(logging.Filter):
    """Errors that launch logs: it does so before it raises, and a reader looks for what it raises.

    They become a part of the failure; without one they are shown at the end.
    """

    def __init__(self) -> None:
        super().__init__()
        self._handler: logging.Handler | None = None
        self._records: list[logging.LogRecord] = []
        self.warned: Callable[[str], None] | None = None
        """Handler of launch_ros's warnings, which have no location."""

    def install(self, handler: logging.Handler) -> None:
        """Hold back what a handler would show."""
        self._handler = handler
        handler.addFilter(self)

    def filter(self, record: logging.LogRecord) -> bool:
        """Hold back an error, hand on a warning; let anything else pass."""
        if (
            self.warned is not None
            and record.levelno == logging.WARNING
            and record.name.startswith("launch_ros.")
        ):
            self.warned(_text(record))
            return False
        is_held = record.levelno >= logging.ERROR and record.name != _USER
        if is_held:
            self._records.append(record)
        return not is_held

    def release(self) -> None:
        """Show what was held back."""
        if self._handler is not None:
            self._handler.removeFilter(self)
            for record in self._records:
                self._handler.handle(record)

    def texts(self, message: str) -> tuple[str, ...]:
        """Return what was held back and says more than a message."""
        found = dict.fromkeys(_text(record) for record in self._records)
        return tuple(each for each in found if each not in message and _NO_DESCRIPTION not in each)


def _text(record: logging.LogRecord) -> str:
    # What the user's code has logged may not fit together.
    with suppress(Exception):
        return record.getMessage().strip()
    return ""


def _write_no_logs(config: Any) -> None:
    """Have launch log to the screen only; its loggers make a folder in the home otherwise."""
    # The folder for all of ROS's logs, so that a configuration is the same each time that it is
    # written; the setter wants a folder that exists.
    folder = log_folder(os.environ) or Path("~/.ros/log").expanduser()
    config._log_dir = str(folder.absolute())  # noqa: SLF001
    config.get_log_file_handler = lambda *_: logging.NullHandler()


def _description(
    job: Job, places: Places, held: HeldErrors, set_alarm: Callable[[], None]
) -> Description:
    import launch  # noqa: PLC0415 - a failure to import it is an answer
    import launch.logging  # noqa: PLC0415
    from launch.actions import IncludeLaunchDescription  # noqa: PLC0415
    from launch.launch_description_sources import AnyLaunchDescriptionSource  # noqa: PLC0415

    from play_launch.launch_files.ros_launch import ends, faster, reading  # noqa: PLC0415
    from play_launch.launch_files.ros_launch.handlers import EventSimulation  # noqa: PLC0415
    from play_launch.launch_files.ros_launch.scene import Scene  # noqa: PLC0415

    _write_no_logs(launch.logging.launch_config)
    held.install(launch.logging.launch_config.get_screen_handler())
    if job.is_faster:
        faster.install(only_arguments=job.only_arguments)
    reading.install(places)
    arguments = [f"{name}:={value}" for name, value in job.arguments]
    context = launch.LaunchContext(argv=arguments, noninteractive=True)
    given = frozenset(name for name, _ in job.arguments)
    scene = Scene(context, places, Path(job.temporary), given)
    held.warned = scene.warned
    # The time is that of the launch file: to import launch takes long where others are busy.
    set_alarm()
    source = AnyLaunchDescriptionSource(job.path)
    if job.only_arguments:
        for action in source.get_launch_description(context).get_launch_arguments():
            scene.declared(action, ends.default_of(action, context))
    else:
        visitor = ends.Visitor(scene)
        events = visitor.events = EventSimulation(scene, visitor.visit)
        ends.install(scene, events)
        loop = asyncio.new_event_loop()
        context._set_asyncio_loop(loop)  # noqa: SLF001 - as LaunchService does
        context._push_locals()  # noqa: SLF001
        # As `ros2 launch` does it, so that the place of the launch file is known in it.
        included = IncludeLaunchDescription(source, launch_arguments=list(job.arguments))
        visitor.visit(launch.LaunchDescription([included]))
        context._pop_locals()  # noqa: SLF001
        events.run()
    scene.take_temporary()
    scene.description.files = list(places.files)
    scene.description.losses = list(scene.losses)
    return scene.description


main()
