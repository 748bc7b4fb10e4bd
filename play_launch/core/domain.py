"""The ROS domain."""

from __future__ import annotations

from typing import Final

LARGEST_DOMAIN: Final = 232
"""With more, port numbers of DDS do not fit into 16 bits; Fast DDS then just ends the process."""
