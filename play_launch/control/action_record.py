"""What was done to a system, who asked for it, and what came of it: events like all others."""

from __future__ import annotations

import asyncio
import contextlib
from itertools import count
from typing import TYPE_CHECKING

from play_launch.control.protocol import LONGEST_COMMAND
from play_launch.recording.resolved_form import redacted_arguments
from play_launch.supervisor.events import ActionEvent, ActionPhase

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Sequence

    from play_launch.control.place import Peer
    from play_launch.runtime.publisher import Publisher


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
    ) -> None:
        self._publisher = publisher
        self._number = number
        self._action = action
        self._targets = tuple(targets)
        self._peer = peer
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
                command=_text_of(self._peer.command),
                reason=reason,
            )
        )


class ActionRecords:
    """Numbers the actions of a session."""

    def __init__(self, publisher: Publisher) -> None:
        """Publish there."""
        self._publisher = publisher
        self._numbers = count(1)

    def begin(self, action: str, targets: Sequence[str], peer: Peer) -> ActionRecord:
        """Give what publishes an action under a number of its own.

        Args:
            action: The operation.
            targets: Full names of members, keys of nodes.
            peer: Who asks.
        """
        number = next(self._numbers)
        return ActionRecord(self._publisher, number, action=action, targets=targets, peer=peer)

    @contextlib.asynccontextmanager
    async def recorded(
        self, action: str, targets: Sequence[str], peer: Peer, besides: str = ""
    ) -> AsyncIterator[ActionRecord]:
        """Publish that something was asked for, and when the block is left, what came of it.

        ``besides`` is what else was asked for.
        """
        record = self.begin(action, targets, peer)
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


def _text_of(command: Sequence[str]) -> str:
    """Write a command line as one line, which can be recorded whatever it holds."""
    text = " ".join(" ".join(redacted_arguments(command)).split())
    return text[:LONGEST_COMMAND].encode("utf-8", "replace").decode()
