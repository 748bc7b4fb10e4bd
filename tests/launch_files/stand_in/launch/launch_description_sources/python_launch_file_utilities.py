"""Reads one."""

from __future__ import annotations

from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from typing import Any


def load_python_launch_file_as_module(path: str) -> Any:
    spec = spec_from_loader("stand_in_launch_file", SourceFileLoader("stand_in_launch_file", path))
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
