"""Where a daemon may listen."""

from __future__ import annotations

from play_launch.graph_daemon.contract import DaemonAddress
from play_launch.graph_daemon.control.port import PortBusyError, listen


def is_free(address: DaemonAddress) -> bool:
    """Whether ros2cli could start its daemon at this moment."""
    try:
        listen(address).close()
    except PortBusyError:
        return False
    return True
