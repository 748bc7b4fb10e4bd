"""``python -m play_launch.fastdds``: removes what dead processes left in shared memory."""

from __future__ import annotations

from play_launch.fastdds.shared_memory import sweep

if __name__ == "__main__":
    sweep()
