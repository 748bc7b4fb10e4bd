"""Where launch logs to."""

from __future__ import annotations

import logging
from typing import Any


class _Config:
    log_dir = ""

    def get_screen_handler(self) -> logging.Handler:
        return logging.NullHandler()

    def get_log_file_handler(self, name: str = "") -> Any:
        raise NotImplementedError


launch_config = _Config()
