"""Changes ros2cli's daemon when Python imports it; written here by play-launch.

``play-launch daemon unpatch`` takes it away again. Imported at each start of this Python, so it
does nothing but put a hook in place, which acts on three modules of ros2cli and on no others. All
modules of this package run with the Python of ROS 2, 3.10 or later.
"""

from __future__ import annotations

import sys

CHANGES = {
    "ros2cli.daemon": "daemon_modules",
    "ros2cli.node.network_aware": "daemon_modules",
    "ros2cli.xmlrpc.local_server": "serving",
}
"""Modules of ros2cli, and the module of ours that changes each."""


class Hook:
    """Stands in front of Python's import machinery."""

    def find_spec(self, name, path=None, target=None):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201 - typing would cost an import
        """Return how to load one of the three modules; None leaves any other to Python."""
        if name not in CHANGES:
            return None
        from importlib import import_module  # noqa: PLC0415 - only with ros2cli

        loading = import_module(f"{__name__}.loading")
        return loading.changed_spec(self, CHANGES[name], name, path, target)


def install() -> None:
    if not any(isinstance(finder, Hook) for finder in sys.meta_path):
        sys.meta_path.insert(0, Hook())
