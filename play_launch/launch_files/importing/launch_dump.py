"""Reads `record.json`, in which the program play_launch (Rust) dumps what launch files say.

Its fields are those of `docs/design/record-format.md` in that project's repository, with what its
parser adds: `param_sources`, the ordered sources of parameters, and `scopes`, the launch files.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, Final

from play_launch.launch_files.importing.fields import (
    Fields,
    as_text,
    file_text,
    inline,
    origin_of,
    parameters,
    set_name,
)
from play_launch.launch_files.parameters import evaluate_sources
from play_launch.launch_files.records import Composable, Description, LaunchedProcess, ProgramKind

if TYPE_CHECKING:
    from collections.abc import Mapping

    from play_launch.launch_files.records import Losses, Source, Unit

LISTS: Final = ("node", "container", "load_node")
_COMPOSABLE: Final = LISTS[-1]
_VARIABLE: Final = re.compile(r"\$\(var\s+([^()\s]+)\s*\)")
_MOST_ROUNDS: Final = 10
"""How often variables may stand in the values of variables."""
_GRAPH: Final = ("expected_graph", "launch_tree")


def is_launch_dump(values: Any) -> bool:
    """Whether the values of a file are such a dump."""
    return isinstance(values, dict) and any(isinstance(values.get(key), list) for key in LISTS)


def read_launch_dump(values: Mapping[str, Any], losses: Losses) -> Description:
    """Return the system in a dump."""
    fields = Fields(values, "(top level)", losses)
    variables = dict(fields.pairs("variables"))
    scopes = _scopes(fields.take("scopes"))
    reader = _Reader(variables, scopes, losses)
    system = Description()
    for name in LISTS:
        records = fields.take(name) or []
        if not isinstance(records, list):
            losses.lost(name, "is not a list")
            continue
        system.units += [
            reader.read(name, record, f"{name}[{number}]") for number, record in enumerate(records)
        ]
    for name in fields.texts("lifecycle_node"):
        losses.note(name, "is a lifecycle node; nobody but your own nodes activates it")
    # What was read from these files stands in the sources of the nodes.
    fields.take("file_data")
    for name in _GRAPH:
        if fields.take(name):
            losses.lost("(top level)", f"{name}: contracts and trees are not checked here")
    fields.refuse_rest()
    return system


def _scopes(values: Any) -> dict[int, str]:
    """Return the launch file of each scope."""
    entries = {
        each["id"]: each
        for each in (values if isinstance(values, list) else ())
        if isinstance(each, dict) and isinstance(each.get("id"), int)
    }
    return {number: _origin(number, entries) for number in entries}


def _origin(number: Any, entries: Mapping[int, Mapping[str, Any]]) -> str:
    for _ in entries:
        entry = entries.get(number)
        if entry is None:
            break
        origin = entry.get("origin")
        if isinstance(origin, dict):
            return "/".join(str(origin[key]) for key in ("pkg", "file") if origin.get(key))
        number = entry.get("parent")
    return ""


class _Reader:
    def __init__(
        self, variables: Mapping[str, str], scopes: Mapping[int, str], losses: Losses
    ) -> None:
        self._variables = variables
        self._scopes = scopes
        self._losses = losses

    def read(self, kind: str, record: Any, where: str) -> Unit:
        fields = Fields(record, where, self._losses)
        is_container = kind == "container"
        node: Unit = (
            Composable(where=where)
            if kind == _COMPOSABLE
            else LaunchedProcess(
                where=where, kind=ProgramKind.CONTAINER if is_container else ProgramKind.NODE
            )
        )
        name = fields.text("node_name" if kind == _COMPOSABLE else "name")
        set_name(node, name, fields.text("namespace"))
        if node.name:
            node.where = fields.where = f"{where} {node.full_name}"
        node.package = fields.text("package")
        node.remappings = fields.pairs("remaps")
        environment = fields.pairs("env")
        scope = fields.take("scope")
        node.origin = origin_of(self._scopes.get(scope, "") if isinstance(scope, int) else "")
        if isinstance(node, Composable):
            if environment:
                what = "environment variables: it shares those of its container"
                self._losses.lost(node.where, what)
            node.plugin = fields.text("plugin")
            node.container = fields.text("target_container_name")
            node.log_level = fields.text("log_level")
            extra = fields.pairs("extra_args")
            node.extra_arguments = list(parameters(extra, node.where, self._losses))
            node.sources = [
                inline(*pair, node.where, self._losses) for pair in fields.pairs("params")
            ]
        else:
            node.environment = environment
            self._read_process(node, fields)
        evaluate_sources(node, self._losses)
        fields.refuse_rest()
        return node

    def _read_process(self, node: LaunchedProcess, fields: Fields) -> None:
        node.executable = self._filled(fields.text("executable"), node)
        node.arguments = [self._filled(each, node) for each in fields.texts("args")]
        node.ros_arguments = [self._filled(each, node) for each in fields.texts("ros_args")]
        command = fields.texts("cmd")
        if not node.package and command:
            # As that program does it: the first word is a whole command line.
            node.command = [*command[0].split(), *command[1:]]
        node.respawn = fields.flag("respawn")
        node.respawn_delay = fields.number("respawn_delay")
        # Only a label of the process.
        fields.take("exec_name")
        node.sources = _sources(fields, self._losses)

    def _filled(self, text: str, node: LaunchedProcess) -> str:
        """Put the values of variables into a text."""
        for _ in range(_MOST_ROUNDS):
            filled = _VARIABLE.sub(lambda found: self._variables.get(found[1], found[0]), text)
            if filled == text:
                break
            text = filled
        if _VARIABLE.search(text):
            self._losses.lost(node.where, f"a variable without a value: {text[:80]}")
        return text


def _sources(fields: Fields, losses: Losses) -> list[Source]:
    common = [inline(*pair, fields.where, losses) for pair in fields.pairs("global_params")]
    values = [inline(*pair, fields.where, losses) for pair in fields.pairs("params")]
    files = [file_text(text) for text in fields.texts("params_files")]
    ordered = ordered_sources(fields, losses)
    # Without the ordered list, what stands in the launch file itself comes last.
    return common + (ordered or files + common + values)


def ordered_sources(fields: Fields, losses: Losses) -> list[Source]:
    """Return the sources of the field `param_sources`, in their order."""
    found: list[Source] = []
    sources = fields.take("param_sources") or []
    for each in sources if isinstance(sources, list) else [sources]:
        kind = each.get("kind") if isinstance(each, dict) else None
        if kind == "inline":
            own = Fields(each, fields.where, losses)
            text = as_text(own.take("value"))
            found.append(inline(own.text("name"), text, fields.where, losses))
        elif kind == "file" and isinstance(each.get("content"), str):
            found.append(file_text(each["content"]))
        else:
            losses.lost(fields.where, "a source of parameters is neither a value nor a file")
    return found
