"""Writes the generated tables of the documentation: ``python -m tests.support.doc_tables``.

A table stands between ``<!-- fields of NAME -->``, ``<!-- keys of NAME ... -->`` or
``<!-- kinds of events -->`` and ``<!-- end -->``. Fields are those of a class of
`play_launch.control.messages`, keys those of sections of the configuration; several sections have a
column each.
"""

from __future__ import annotations

import ast
import inspect
import re
from pathlib import Path
from typing import TYPE_CHECKING, Final

import msgspec

from play_launch.config import schema, sections
from play_launch.control import messages
from play_launch.control.event_words import EVENT_TYPES

if TYPE_CHECKING:
    from play_launch.config.section import ConfigSection

DOCS: Final = Path(__file__).parents[2] / "docs"
DOCUMENTS: Final = tuple(sorted(DOCS.glob("*.md")))
_TABLE: Final = re.compile(r"(<!-- (\w+) of ([\w ]+) -->\n).*?(<!-- end -->)", re.DOTALL)
_HEADING: Final = re.compile(r"^#+ (.+)$", re.MULTILINE)
_COLUMNS: Final = {
    "LoadingSection": "all",
    "ContainerSection": "container",
    "ComposableNodeSection": "node",
    "ProcessSection": "process",
}


def with_tables(text: str) -> str:
    """Return the text of a document with its tables as they should be."""
    headings = {found.lower().replace(" ", "-") for found in _HEADING.findall(text)}

    def written(found: re.Match[str]) -> str:
        names = found[3].split()
        rows = _keys(names, headings) if found[2] == "keys" else _TABLES[found[2]](names[0])
        return "\n".join([found[1].rstrip("\n"), *rows, found[4]])

    return _TABLE.sub(written, text)


def _fields(name: str) -> list[str]:
    kind = getattr(messages, name)
    about = _docstrings(kind)
    rows = [
        f"| `{field.encode_name}` | {about[field.name]} |"
        for field in msgspec.structs.fields(kind)
        if field.name in about
    ]
    return ["| field | |", "| --- | --- |", *rows]


def _first(kind: type) -> str:
    return (inspect.getdoc(kind) or "").partition("\n\n")[0]


def _kinds(_name: str) -> list[str]:
    rows = (f"| `{word}` | {_first(kind)} |" for kind, word in EVENT_TYPES.items())
    return ["| kind | |", "| --- | --- |", *(row.replace("``", "`") for row in rows)]


_TABLES: Final = {"fields": _fields, "kinds": _kinds}


def _keys(names: list[str], headings: set[str]) -> list[str]:
    rows: dict[tuple[str, str], list[str]] = {}
    for name in names:
        section: type[ConfigSection] = getattr(schema, name, None) or getattr(sections, name)
        for key, declared in section.keys.items():
            about = declared.description + (" Required." if declared.required else "")
            rows.setdefault((key, about), []).append(name)
    if len(names) == 1:
        head = ["| key | value |", "| --- | --- |"]
    else:
        columns = [_COLUMNS[name] for name in names]
        head = [f"| key | {' | '.join(columns)} | value |", "| --- " * (len(names) + 2) + "|"]
    lines = []
    for (key, about), owners in sorted(rows.items()) if len(names) > 1 else rows.items():
        shown = f"[`{key}`](#{key})" if key in headings else f"`{key}`"
        marks = [" x |" if name in owners else " |" for name in names] if len(names) > 1 else []
        lines.append(f"| {shown} |{''.join(marks)} {about} |")
    return [*head, *lines]


def _docstrings(kind: type[msgspec.Struct]) -> dict[str, str]:
    """Return the docstrings of a class's own fields, and of its small bases."""
    (tree,) = ast.parse(inspect.getsource(kind)).body
    assert isinstance(tree, ast.ClassDef)
    found = {}
    for before, after in zip(tree.body, tree.body[1:], strict=False):
        match before, after:
            case (
                ast.AnnAssign(target=ast.Name(id=name)),
                ast.Expr(value=ast.Constant(value=str(text))),
            ):
                found[name] = " ".join(text.split())
    if kind is not messages.UnitStatus:  # its table follows that of its base
        for base in kind.__bases__:
            if base.__module__ == messages.__name__:
                found = _docstrings(base) | found
    return found


if __name__ == "__main__":
    for document in DOCUMENTS:
        document.write_text(with_tables(document.read_text(encoding="utf-8")), encoding="utf-8")
