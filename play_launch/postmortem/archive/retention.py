"""Which sessions go when only so many, or so many bytes, are to be kept."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from play_launch.config.model import KeepConfig
    from play_launch.postmortem.archive.folders import SessionEntry


def sessions_to_remove(
    sessions: Sequence[SessionEntry], keep: KeepConfig
) -> tuple[SessionEntry, ...]:
    """Of sessions, the oldest first, those to remove; none that runs, and none that is pinned.

    Limits hold for all that are not pinned, running ones included. Those may exceed them.
    """
    counted = [one for one in sessions if not one.is_pinned]
    count, size = len(counted), sum(one.size for one in counted)
    removed: list[SessionEntry] = []
    for session in counted:
        fits = (keep.sessions is None or count <= keep.sessions) and (
            keep.size is None or size <= keep.size
        )
        if fits:
            break
        if not session.is_running:
            removed.append(session)
            count, size = count - 1, size - session.size
    return tuple(removed)
