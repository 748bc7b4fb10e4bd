"""Events as JSON, one object a line, for programs that watch a run."""

from __future__ import annotations

import json
from typing import IO, TYPE_CHECKING

from play_launch.supervisor.event_object import event_object
from play_launch.supervisor.events import OutputLine, RunEvent, Sample

if TYPE_CHECKING:
    from collections.abc import Sequence

    from play_launch.cli.show.display import Shown


class JsonStyle:
    """Writes events to a stream as they come."""

    def __init__(self, stream: IO[str], *, quiet: bool) -> None:
        """``quiet`` leaves the output of nodes away."""
        self._stream = stream
        self._quiet = quiet

    def wants(self, event: RunEvent) -> bool:
        """Everything but samples, of which there are many, and output when it is not wanted."""
        if isinstance(event, OutputLine):
            return not self._quiet
        return not isinstance(event, Sample)

    def show(self, batch: Sequence[Shown], missed: int) -> float | None:
        """Write one object for each event."""
        objects = [event_object(shown.event) for shown in batch]
        if missed:
            objects.append({"event": "missed", "lines": missed})
        if objects:
            self._stream.write("".join(f"{encode(values)}\n" for values in objects))
            self._stream.flush()
        return None

    def close(self) -> None:
        """Nothing to restore."""


def encode(values: dict[str, object]) -> str:
    """Write one object on one line; plain ASCII, so that no stream's encoding can refuse it."""
    return json.dumps(values, separators=(",", ":"))
