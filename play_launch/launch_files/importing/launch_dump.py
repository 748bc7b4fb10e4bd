"""Reads `record.json`, in which the program play_launch (Rust) dumps what launch files say.

Its fields are those of `docs/design/record-format.md` in that project's repository, with what its
parser adds: `param_sources`, the ordered sources of parameters, and `scopes`, the launch files.
"""

from __future__ import annotations

import re
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from play_launch.launch_files.importing.fields import Fields, read_unit
from play_launch.launch_files.records import Description, ProgramKind

if TYPE_CHECKING:
    from collections.abc import Mapping

    from play_launch.launch_files.records import Losses

LISTS: Final = {"node": ProgramKind.NODE, "container": ProgramKind.CONTAINER, "load_node": None}
_VARIABLE: Final = re.compile(r"\$\(var\s+([^()\s]+)\s*\)")
_MOST_ROUNDS: Final = 10
"""How often variables may stand in the values of variables."""
_GRAPH: Final = ("expected_graph", "launch_tree")


def is_launch_dump(values: Any) -> bool:
    """Whether the values of a file are such a dump."""
    return isinstance(values, dict) and any(isinstance(values.get(key), list) for key in LISTS)


def read_launch_dump(values: Mapping[str, Any], losses: Losses) -> Description:
    fields = Fields(values, "(top level)", losses)
    variables = dict(fields.pairs("variables"))
    scopes = _scopes(fields.take("scopes"))
    system = Description()
    for name in LISTS:
        records = fields.take(name) or []
        if not isinstance(records, list):
            losses.lost(name, "is not a list")
            continue
        for number, record in enumerate(records):
            unit = Fields(record, f"{name}[{number}]", losses)
            scope = unit.take("scope")
            file = scopes.get(scope, "") if isinstance(scope, int) else ""
            unit.take("exec_name")  # only a label of the process
            filled = partial(_filled, variables=variables, fields=unit)
            system.units.append(read_unit(unit, LISTS[name], file, filled))
            unit.refuse_rest()
    for name in fields.get("lifecycle_node", list[str]) or ():
        losses.note(name, "is a lifecycle node; only your own nodes activate it")
    # What was read from these files stands in the sources of the nodes.
    fields.take("file_data")
    for name in _GRAPH:
        if fields.take(name):
            losses.lost("(top level)", f"{name}: contracts and trees are not checked here")
    fields.refuse_rest()
    return system


def _scopes(values: Any) -> dict[int, str]:
    """Return the launch file of each scope, which may be that of one above it."""
    found: dict[int, str] = {}
    for each in values if isinstance(values, list) else ():
        match each:
            case {"id": int(number), "origin": dict(origin)}:
                keys = ("pkg", "file")
                found[number] = "/".join(str(origin[key]) for key in keys if origin.get(key))
            case {"id": int(number), "parent": int(parent)}:
                found[number] = found.get(parent, "")
    return found


def _filled(text: str, variables: Mapping[str, str], fields: Fields) -> str:
    """Put the values of variables into a text."""
    for _ in range(_MOST_ROUNDS):
        filled = _VARIABLE.sub(lambda found: variables.get(found[1], found[0]), text)
        if filled == text:
            break
        text = filled
    if _VARIABLE.search(text):
        fields.losses.lost(fields.where, f"a variable without a value: {text[:80]}")
    return text
