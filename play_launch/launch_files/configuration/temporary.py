"""Temporary files that units name: copies of them take their places."""

from __future__ import annotations

import re
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, Final

import msgspec
from msgspec.structs import replace

from play_launch.launch_files.records import Description

if TYPE_CHECKING:
    from collections.abc import Mapping

    from play_launch.launch_files.configuration.copies import Copies
    from play_launch.launch_files.losses import Losses

_RANDOM: Final = re.compile(r"[a-z0-9_]{8}$", re.ASCII)
"""What `tempfile` makes of a name, which is another one each time."""


def with_copies(description: Description, copies: Copies | None, losses: Losses) -> Description:
    """Name copies in place of temporary files; without copies, what names them is reported."""
    if not description.temporary:
        return description
    if copies is None:
        for unit in description.units:
            text = str(msgspec.to_builtins(unit))
            for each in description.temporary:
                if each.path in text:
                    what = f"it names a temporary file, which does not stay: {each.path}"
                    losses.lost(unit.described, what)
        return description
    names = {
        each.path: copies.add(_name(each.path), each.content) for each in description.temporary
    }
    # Of two paths of which one begins with the other, the longer one first.
    ordered = dict(sorted(names.items(), key=lambda pair: -len(pair[0])))
    values = msgspec.to_builtins(replace(description, temporary=[]))
    return msgspec.convert(_replaced(values, ordered), Description)


def _name(path: str) -> str:
    stem, dot, ending = PurePath(path).name.partition(".")
    return f"{_RANDOM.sub('', stem).strip('_-') or 'file'}{dot}{ending}"


def _replaced(value: Any, names: Mapping[str, str]) -> Any:
    if isinstance(value, str):
        for before, after in names.items():
            value = value.replace(before, after)
        return value
    if isinstance(value, dict):
        return {key: _replaced(each, names) for key, each in value.items()}
    if isinstance(value, list):
        return [_replaced(each, names) for each in value]
    return value
