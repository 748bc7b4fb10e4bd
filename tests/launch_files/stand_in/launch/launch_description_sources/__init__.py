"""Launch files in Python."""

from __future__ import annotations

from typing import Any

from . import python_launch_file_utilities


class AnyLaunchDescriptionSource:
    def __init__(self, path: str) -> None:
        self.location = path

    def get_launch_description(self, context: Any) -> Any:
        module = python_launch_file_utilities.load_python_launch_file_as_module(self.location)
        return module.generate_launch_description()
