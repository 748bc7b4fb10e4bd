"""Reads a description of another program, and writes the configuration that it becomes."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, Final

from play_launch import UserError
from play_launch.config.compose import Reading, Tally, compose
from play_launch.config.problems import Report
from play_launch.config.source import Refused, decode, read_bytes
from play_launch.config.tree import Mapping, Scalar
from play_launch.launch_files.configuration.request import Containers, Options
from play_launch.launch_files.configuration.write import written
from play_launch.launch_files.importing.launch_dump import is_launch_dump, read_launch_dump
from play_launch.launch_files.importing.system_model import is_system_model, read_system_model
from play_launch.launch_files.records import Losses

if TYPE_CHECKING:
    from pathlib import Path

    from play_launch.config.tree import Node
    from play_launch.launch_files.configuration.write import Written

LARGEST: Final = 64 * 2**20
"""Bytes of a description; dumps hold the text of every parameter file."""
MOST_VALUES: Final = 2_000_000


class NotImportableError(UserError):
    """The file is no description that is known here; the text is the reason."""


def import_system(path: Path, *, stock: bool = False) -> Written:
    """Turn `record.json` or `system_model.yaml` into a configuration.

    Raises:
        NotImportableError: When it is neither, or cannot be read.
    """
    values = _values_of(path)
    losses = Losses()
    if is_launch_dump(values):
        system = read_launch_dump(values, losses)
    elif is_system_model(values):
        system = read_system_model(values, losses)
    else:
        raise NotImportableError(
            f"{path}: is neither a record.json (with lists node, container or load_node) nor a "
            "system_model.yaml (with structure)"
        )
    system.losses = list(losses)
    kept = Containers.STOCK if stock else Containers.SAME
    return written(
        system, Options(containers=kept, folder=path.parent), f"Imported from {path.name}."
    )


def _values_of(path: Path) -> Any:
    content = read_bytes(path, LARGEST)
    if isinstance(content, Refused):
        raise NotImportableError(f"{path}: {content.message}")
    if content.lstrip()[:1] in (b"{", b"["):
        try:
            return json.loads(content)
        except (ValueError, RecursionError) as error:
            raise NotImportableError(f"{path}: is not JSON: {error}") from error
    text = decode(content, str(path))
    if isinstance(text, Refused):
        raise NotImportableError(f"{text.location}: {text.message}")
    report = Report()
    root = compose(text, str(path), report, Reading(tally=Tally(MOST_VALUES), nulls=True))
    for problem in report:
        raise NotImportableError(str(problem))
    return None if root is None else _plain(root)


def _plain(node: Node) -> Any:
    if isinstance(node, Scalar):
        return node.value
    if isinstance(node, Mapping):
        return {entry.key: _plain(entry.value) for entry in node.entries}
    return [_plain(item) for item in node.items]
