"""A container's program that has been linked, and is forked for each container.

Linking takes longer than all else that a container does before it meets the middleware, and comes
to the same in every container. The other side is ``container_native/src/main/zygote.hpp``.

This module, and what it imports, is loaded before anything else of `replay`: see
`play_launch.runtime.prestart`.
"""

from __future__ import annotations

import logging
import os
import re
import socket
from contextlib import ExitStack
from typing import TYPE_CHECKING, Final, Self

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from play_launch.process.guard import SessionGuard

_READ_BEFORE_MAIN: Final = re.compile(
    # The dynamic linker and the C library; the C++ library; the allocators.
    r"LD_.*|GLIBC_TUNABLES|MALLOC_.*|LIBC_.*|GCONV_PATH|LOCPATH|NLSPATH|LANG|LANGUAGE|LC_.*|TZ|TZDIR"
    r"|GLIBCXX_.*|(?i:MIMALLOC_.*)|_RJEM_.*|JE_.*"
    # What else is linked: cryptography, tracing, the check which middleware this is.
    r"|OPENSSL_.*|LTTNG_.*|HOME|RMW_IMPLEMENTATION|RCL_ASSERT_RMW_ID_MATCHES"
)
"""Variables that are read when a container's program is loaded, before its main()."""
_PRELOADED_BY_US: Final = re.compile(r"lib(?:mimalloc|jemalloc|fastdds_waits)\.so[.\d]*")

_log = logging.getLogger(__name__)


class Zygote:
    """Such a process; belongs to the thread of its guard.

    Attributes:
        number: What its guard knows it by.
    """

    def __init__(
        self,
        program: str,
        environment: Mapping[str, str],
        ours: socket.socket,
        number: int,
    ) -> None:
        self.number = number

        self._program = program
        self._environment = environment
        self._socket = ours

    @classmethod
    def start(cls, guard: SessionGuard, program: Path, environment: Mapping[str, str]) -> Self:
        """Have the guard start it, without waiting for that; raises OSError."""
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with ExitStack() as opened, ExitStack() as on_failure, theirs:
            on_failure.callback(ours.close)
            nothing = os.open(os.devnull, os.O_RDWR | os.O_CLOEXEC)
            opened.callback(os.close, nothing)
            end = theirs.fileno()
            descriptors = {**dict.fromkeys(range(3), nothing), end: end}
            argv = [os.fspath(program), "--zygote", str(end)]
            helper = guard.spawn_helper(argv, environment, descriptors)
            on_failure.pop_all()
        return cls(argv[0], dict(environment), ours, helper)

    def can_become(self, program: str, environment: Mapping[str, str]) -> bool:
        """Whether a fork of it is like that program executed with that environment."""
        return (
            self._socket.fileno() >= 0
            and program == self._program
            and is_loaded_alike(self._environment, environment)
        )

    def fileno(self) -> int:
        """Our end of its socket."""
        return self._socket.fileno()

    def lose(self, reason: str) -> None:
        """Have it end, because of an error."""
        if self._socket.fileno() < 0:
            return
        _log.info(
            "containers are executed one by one, as a linked one cannot be forked: %s", reason
        )
        self.close()

    def close(self) -> None:
        """Have it end; may be called twice."""
        self._socket.close()


def is_read_before_main(variable: str) -> bool:
    """Whether a container's program reads it while it is loaded."""
    return _READ_BEFORE_MAIN.fullmatch(variable) is not None


def is_loaded_alike(one: Mapping[str, str], other: Mapping[str, str]) -> bool:
    """Whether a program is in the same state at the beginning of main() in both environments.

    Other libraries that are preloaded may read anything, so there it is never known.
    """
    preloaded = [name for name in re.split(r"[: ]", one.get("LD_PRELOAD", "")) if name]
    if not all(_PRELOADED_BY_US.fullmatch(name.rpartition("/")[2]) for name in preloaded):
        return False
    return not any(is_read_before_main(name) for name, _ in one.items() ^ other.items())
