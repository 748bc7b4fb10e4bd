"""Where launch logs to."""

from __future__ import annotations

from typing import Any


class _Config:
    log_dir = ""

    def get_log_file_handler(self, name: str = "") -> Any:
        raise NotImplementedError


launch_config = _Config()
