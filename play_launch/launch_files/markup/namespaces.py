"""Namespaces of nodes, put together as launch_ros does it."""

from __future__ import annotations

import re
from typing import Final

from play_launch.launch_files.markup.trouble import Trouble

_VALID: Final = re.compile(r"/|(?:/[A-Za-z_][A-Za-z0-9_]*)+", re.ASCII)


def joined(base: str | None, own: str | None) -> str | None:
    """Return the absolute namespace; None where nobody gives one.

    Raises:
        Trouble: When it is no namespace.
    """
    if own is None:
        namespace = base
    elif not base or own.startswith("/"):
        namespace = own
    else:
        namespace = f"{'' if base == '/' else base}/{own}"
    if namespace is None:
        return None
    if namespace != "/":
        namespace = namespace.rstrip("/")
    if not namespace.startswith("/"):
        namespace = f"/{namespace}"
    if not _VALID.fullmatch(namespace):
        raise Trouble(f"{namespace!r} is no namespace")
    return namespace
