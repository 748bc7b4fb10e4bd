"""Texts with substitutions, `$(name argument ...)`, as trees; nothing is evaluated here.

The grammar is that of launch (`grammar.lark`), escapes by backslash included.
"""

from __future__ import annotations

import re
from typing import Final, TypeAlias

from msgspec import Struct

from play_launch.launch_files.markup.trouble import Trouble

_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_-]*", re.ASCII)
_ESCAPE: Final = re.compile(r"\\(.)")
_MOST_LEVELS: Final = 50


class Call(Struct, frozen=True):
    """A substitution; arguments are texts with substitutions themselves."""

    name: str
    arguments: tuple[Template, ...]


Template: TypeAlias = "tuple[str | Call, ...]"


def unescaped(text: str) -> str:
    """Return a text without the backslashes before characters."""
    return _ESCAPE.sub(r"\1", text)


def parse(text: str) -> Template:
    """Return the parts of a text.

    Raises:
        Trouble: When a substitution is not written as launch wants it.
    """
    if "$(" not in text:
        return (unescaped(text),) if text else ("",)
    return _Parser(text).template("")


class _Parser:
    def __init__(self, text: str) -> None:
        self._text = text
        self._at = 0
        self._level = 0

    def template(self, end: str) -> Template:
        """Read up to the quotation mark `end`, or, where that is empty, to the end of the text."""
        parts: list[str | Call] = []
        begin = self._at
        while self._at < len(self._text):
            character = self._text[self._at]
            if character == "\\":
                self._at += 2
            elif character == end:
                break
            elif self._text.startswith("$(", self._at):
                self._add(parts, begin)
                parts.append(self._call(end))
                begin = self._at
            else:
                self._at += 1
        else:
            if end:
                raise self._wrong(f"a {end} is not closed")
        self._at = min(self._at, len(self._text))
        self._add(parts, begin)
        return tuple(parts)

    def _add(self, parts: list[str | Call], begin: int) -> None:
        if begin < self._at:
            parts.append(unescaped(self._text[begin : self._at]))

    def _call(self, quoted: str) -> Call:
        self._level += 1
        if self._level > _MOST_LEVELS:
            raise self._wrong("substitutions are nested too deeply")
        self._at += 2
        found = _NAME.match(self._text, self._at)
        if not found:
            raise self._wrong("a substitution begins with its name")
        self._at = found.end()
        arguments: list[Template] = []
        while self._next() == " ":
            self._at += 1
            arguments.append(self._argument(quoted))
        if self._next() != ")":
            raise self._wrong("a substitution is not closed")
        self._at += 1
        self._level -= 1
        return Call(found[0], tuple(arguments))

    def _argument(self, quoted: str) -> Template:
        character = self._next()
        if not quoted and character in ("'", '"'):
            self._at += 1
            template = self.template(character)
            self._at += 1
            return template
        parts: list[str | Call] = []
        begin = self._at
        refused = {quoted} if quoted else {"'", '"'}
        while self._at < len(self._text):
            character = self._text[self._at]
            if character == "\\":
                self._at += 2
            elif self._text.startswith("$(", self._at):
                self._add(parts, begin)
                parts.append(self._call(quoted))
                begin = self._at
            elif character in " )":
                break
            elif character == "(" or character in refused:
                raise self._wrong(f"{character} stands in an argument; put it in quotes")
            else:
                self._at += 1
        self._at = min(self._at, len(self._text))
        self._add(parts, begin)
        if not parts:
            raise self._wrong("an argument is missing behind a space")
        return tuple(parts)

    def _next(self) -> str:
        return self._text[self._at] if self._at < len(self._text) else ""

    def _wrong(self, message: str) -> Trouble:
        shown = self._text if len(self._text) <= 80 else f"{self._text[:77]}..."
        return Trouble(f"{shown!r}: {message}")
