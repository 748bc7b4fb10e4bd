"""What was done to a system, who asked for it, and what came of it: events like all others."""

from __future__ import annotations

import asyncio
import contextlib
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Final

from play_launch.core.events import ActionEvent, ActionPhase
from play_launch.recording.resolved_form import redacted_arguments

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Sequence

    from play_launch.actors.publisher import Publisher
    from play_launch.control.place import Peer

_LONGEST_COMMAND: Final = 1000
"""Bytes of a command line that are recorded."""


class ActionRecord:
    """Publishes what was asked, by whom, and what came of it."""

    def __init__(
        self,
        publisher: Publisher,
        number: int,
        *,
        action: str,
        targets: Sequence[str],
        peer: Peer,
        command: str,
    ) -> None:
        self._publisher = publisher
        self._number = number
        self._action = action
        self._targets = tuple(targets)
        self._peer = peer
        self._command = command
        self.failure = ""
        """Why it failed; empty: it did not."""

    def publish(self, phase: ActionPhase, reason: str) -> None:
        """Publish how far it is; of a request, `reason` is what was asked for besides."""
        self._publisher.publish(
            ActionEvent(
                stamp_ns=self._publisher.stamp_ns(),
                number=self._number,
                action=self._action,
                phase=phase,
                targets=self._targets,
                uid=self._peer.uid,
                pid=self._peer.pid,
                command=self._command,
                reason=reason,
            )
        )


class ActionRecords:
    """Numbers the actions of a session."""

    def __init__(self, publisher: Publisher) -> None:
        """Publish there."""
        self._publisher = publisher
        self._numbers = count(1)

    async def begin(self, action: str, targets: Sequence[str], peer: Peer) -> ActionRecord:
        """Give what publishes an action under a number of its own.

        Args:
            action: The operation.
            targets: Full names of members, keys of nodes.
            peer: Who asks.
        """
        command = await asyncio.to_thread(command_of, peer.pid)
        return ActionRecord(
            self._publisher,
            next(self._numbers),
            action=action,
            targets=targets,
            peer=peer,
            command=command,
        )

    @contextlib.asynccontextmanager
    async def recorded(
        self, action: str, targets: Sequence[str], peer: Peer, besides: str = ""
    ) -> AsyncIterator[ActionRecord]:
        """Publish that something was asked for, and when the block is left, what came of it.

        ``besides`` is what else was asked for.
        """
        record = await self.begin(action, targets, peer)
        record.publish(ActionPhase.REQUESTED, besides)
        try:
            yield record
        except asyncio.CancelledError:
            record.failure = "its client left, or the session ended"
            raise
        except Exception as error:
            record.failure = str(error)
            raise
        finally:
            failed = bool(record.failure)
            record.publish(ActionPhase.FAILED if failed else ActionPhase.DONE, record.failure)


def command_of(pid: int) -> str:
    """Read the command line of a process, as one line; empty where it cannot be read."""
    try:
        data = Path(f"/proc/{pid}/cmdline").read_bytes()[:_LONGEST_COMMAND]
    except OSError:
        return ""
    words = redacted_arguments(data.decode("utf-8", "replace").split("\0"))
    return " ".join(" ".join(words).split())
