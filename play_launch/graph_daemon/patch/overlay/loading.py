"""Loads a module of ros2cli as Python would, and changes it afterwards.

Only with the releases that the changes were written for; any other stays as upstream has it.
"""

from __future__ import annotations

import importlib
import importlib.abc
import importlib.metadata
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Sequence
    from importlib.machinery import ModuleSpec
    from types import ModuleType

MARK = "__play_launch__"
"""Set in a module that was changed: the name of the change, or what went wrong."""
KNOWN = ("0.18.", "0.32.")
"""Series of ros2cli: Humble's and Jazzy's."""


def changed_spec(
    hook: Any, change: str, name: str, path: Sequence[str] | None, target: ModuleType | None
) -> ModuleSpec | None:
    """Find ``name`` with the other finders and put ``change`` behind its loading."""
    spec = _found_by_others(hook, name, path, target)
    if spec is None or spec.loader is None or not _is_known():
        return spec
    spec.loader = ChangingLoader(spec.loader, change)
    return spec


class ChangingLoader(importlib.abc.Loader):
    """A module's own loader, and a change after it."""

    def __init__(self, loader: Any, change: str) -> None:
        self._loader = loader
        self._change = change

    def __getattr__(self, name: str) -> Any:
        """Be the real loader in everything else; ``inspect`` asks it for the source."""
        return getattr(self._loader, name)

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        """Leave it to the real loader."""
        module: ModuleType | None = self._loader.create_module(spec)
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Run the module, then change it; if that fails, the module stays upstream's."""
        self._loader.exec_module(module)
        try:
            importlib.import_module(f"{__package__}.{self._change}").apply(module)
        except Exception as error:  # noqa: BLE001 - ros2 must go on working
            setattr(module, MARK, f"{self._change} failed: {error!r}")
        else:
            setattr(module, MARK, self._change)


def _found_by_others(
    hook: Any, name: str, path: Sequence[str] | None, target: ModuleType | None
) -> ModuleSpec | None:
    for finder in list(sys.meta_path):
        find = getattr(finder, "find_spec", None)
        if finder is hook or find is None:
            continue
        spec: ModuleSpec | None = find(name, path, target)
        if spec is not None:
            return spec
    return None


def _is_known() -> bool:
    try:
        version = importlib.metadata.version("ros2cli")
    except importlib.metadata.PackageNotFoundError:
        return False
    return version.startswith(KNOWN)
