"""``python -m play_launch.ros.fastdds``: removes what dead processes left in shared memory."""

from __future__ import annotations

from play_launch.ros.fastdds.shared_memory import sweep

if __name__ == "__main__":
    sweep()
