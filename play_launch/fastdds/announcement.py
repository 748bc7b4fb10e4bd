"""How soon our own participants meet those that start later.

While many processes start, Fast DDS 2.14 often misses a newcomer's first announcements, which come
within half a second. Measured with 15 containers on two cores: four participants of a group stayed
unknown for 3 s, until our own participant announced itself again, as it does every 3 s
(``leaseAnnouncement``), and they answered that. So ours announce themselves every 0.2 s: then
nearly all were known within 0.8 s. Now and then one still took 3 s, for a reason that is not known.
"""

from __future__ import annotations

import contextlib
import ctypes
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Final

from play_launch.fastdds.middleware import is_fastdds
from play_launch.fastdds.profiles import files_here, profile_in_use

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

_VARIABLE: Final = b"FASTRTPS_DEFAULT_PROFILES_FILE"
PROFILE: Final = Path(__file__).with_name("quick_announcement.xml")
_lock = threading.Lock()


@contextlib.contextmanager
def quick_announcement(environment: Mapping[str, str], rmw: str) -> Iterator[None]:
    """Participants that are made in the block announce themselves often.

    Fast DDS reads profiles once, when a process makes its first participant; so this is to be
    around the first one. Nothing happens with another middleware, and where somebody has
    configured Fast DDS.

    The variable is set past ``os.environ``: children are started with what stands there, and must
    not get our profile.

    Args:
        environment: That of this process.
        rmw: The middleware in use.
    """
    if not is_fastdds(rmw) or profile_in_use(environment, files_here()) is not None:
        yield
        return
    libc = ctypes.CDLL(None)
    with _lock:
        libc.setenv(_VARIABLE, bytes(PROFILE), 1)
        try:
            yield
        finally:
            libc.unsetenv(_VARIABLE)
