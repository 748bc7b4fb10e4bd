"""Values that are given as text, typed as the launch system types them."""

from __future__ import annotations

import re
from typing import Final

from play_launch.config.compose import compose
from play_launch.config.model import ParameterType, ParameterValue
from play_launch.config.problems import Report, excerpt
from play_launch.config.resolve.parameters import flatten
from play_launch.config.tree import Cursor, Entry, Mapping, Sequence
from play_launch.launch_files.records import Parameter, parameter

_INTEGER: Final = re.compile(r"[-+]?[0-9]+", re.ASCII)
_DOUBLE: Final = re.compile(r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?", re.ASCII)
_TRUTH: Final = {"true": True, "True": True, "false": False, "False": False}

_Values = dict[str, ParameterValue]


def typed_values(name: str, text: str) -> list[Parameter] | None:
    """Return the parameters that a text gives; None: no value.

    A mapping gives several, whose names are joined with dots.
    """
    found = _typed(name, text)
    return None if found is None else [parameter(*pair) for pair in found.items()]


def _typed(name: str, text: str) -> _Values | None:
    if text in _TRUTH:
        return {name: ParameterValue(ParameterType.BOOL, _TRUTH[text])}
    if _INTEGER.fullmatch(text) and -(2**63) <= int(text) < 2**63:
        return {name: ParameterValue(ParameterType.INTEGER, int(text))}
    if _DOUBLE.fullmatch(text) and not _INTEGER.fullmatch(text):
        return {name: ParameterValue(ParameterType.DOUBLE, float(text))}
    if text.lstrip().startswith(("[", "{")):
        found = _collection(name, text)
        if found is not None:
            return found or None
    return {name: ParameterValue(ParameterType.STRING, text)} if text else None


def _collection(name: str, text: str) -> _Values | None:
    """Return what a list or mapping gives, empty where it has no type; None: it is neither."""
    report = Report()
    root = compose(text.strip(), excerpt(name), report)
    if len(report) > 0 or not isinstance(root, Mapping | Sequence):
        return None
    if isinstance(root, Sequence) and not root.items:
        return {}
    values = flatten(
        Cursor(Mapping(root.location, {name: Entry(name, root.location, root)}), "", report)
    )
    if len(report) == 0:
        return values
    numbers = [getattr(item, "value", None) for item in getattr(root, "items", ())]
    if numbers and all(isinstance(each, int | float) for each in numbers):
        doubles = tuple(float(each) for each in numbers if isinstance(each, int | float))
        return {name: ParameterValue(ParameterType.DOUBLE_ARRAY, doubles)}
    return None
