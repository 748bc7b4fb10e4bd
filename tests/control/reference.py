"""Writes the tables of messages in the documentation: ``python -m tests.control.reference``.

A table stands between ``<!-- fields of NAME -->`` and ``<!-- end -->``; it is made from the
docstrings of the class of that name in `play_launch.control.messages`.
"""

from __future__ import annotations

import ast
import inspect
import re
from pathlib import Path

import msgspec

from play_launch.control import messages

DOCS = Path(__file__).parents[2] / "docs"
DOCUMENTS = (DOCS / "control.md", DOCS / "apply.md")
_TABLE = re.compile(r"(<!-- fields of (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)


def with_tables(text: str) -> str:
    """Return the text of a document with its tables as they should be."""
    return _TABLE.sub(lambda found: f"{found[1]}{_table(found[2])}{found[3]}", text)


def _table(name: str) -> str:
    kind = getattr(messages, name)
    about = _docstrings(kind)
    rows = [
        f"| `{field.encode_name}` | {about[field.name]} |"
        for field in msgspec.structs.fields(kind)
        if field.name in about
    ]
    return "\n".join(["| field | |", "| --- | --- |", *rows, ""])


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
