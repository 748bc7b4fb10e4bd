"""What the recorder wants from a bag file, whatever library writes it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from play_launch.recording.topics import Topic


class BagWriter(Protocol):
    """A bag that is being written.

    All times are nanoseconds since the epoch. Every method may raise
    :class:`~play_launch.recording.errors.WriteFailedError`; after that only :meth:`abandon` may
    follow. A writer belongs to one thread at a time.
    """

    @property
    def path(self) -> Path:
        """Where the data is now; it changes once, when :meth:`close` succeeds."""

    @property
    def bytes_written(self) -> int:
        """Size of the file in bytes."""

    @property
    def messages(self) -> int:
        """Messages in the file: those that :meth:`flush` has reached, or a full chunk."""

    def register(self, topic: Topic) -> int:
        """Announce a topic and return its channel, to be given to :meth:`write`."""

    def write(self, channel: int, data: bytes, *, log_time: int, publish_time: int) -> None:
        """Append one CDR-serialised message (with its 4-byte encapsulation header)."""

    def attach(self, name: str, media_type: str, data: bytes, *, time: int) -> None:
        """Put a file of its own into the bag."""

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Put a record of names and values into the bag."""

    def flush(self) -> None:
        """Hand everything over to the kernel: it then survives the death of this process."""

    def close(self) -> None:
        """Complete the file, make it durable and give it its final name."""

    def abandon(self) -> None:
        """Let go of the file as it is; what was flushed stays readable. Never raises."""
