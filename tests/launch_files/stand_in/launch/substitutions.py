"""Texts, and values of launch arguments."""

from __future__ import annotations

from typing import Any


class TextSubstitution:
    def __init__(self, *, text: str) -> None:
        self.text = text

    def describe(self) -> str:
        return self.text

    def perform(self, context: Any) -> str:
        return self.text


class LaunchConfiguration:
    def __init__(self, name: str) -> None:
        self.name = name

    def describe(self) -> str:
        return f"LaunchConfig({self.name})"

    def perform(self, context: Any) -> str:
        if self.name not in context.launch_configurations:
            raise RuntimeError(f"launch configuration '{self.name}' does not exist")
        return str(context.launch_configurations[self.name])
