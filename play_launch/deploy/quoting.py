"""Texts as a unit file wants them, see "Quoting" in systemd.syntax(7) and systemd.service(5)."""

from __future__ import annotations

from typing import Final

_ESCAPED: Final = {"\\": "\\\\", '"': '\\"', "\n": "\\n", "\t": "\\t"}
_PLAIN: Final = frozenset("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789/._-+:=,@")


def specified(text: str) -> str:
    """Write a text for a setting that takes it as it is, but for specifiers (``%n``)."""
    return text.replace("%", "%%")


def quoted(text: str) -> str:
    """Write one word of a setting that takes several, such as ``Environment=``."""
    if text and _PLAIN.issuperset(text):
        return text
    return '"' + "".join(_ESCAPED.get(each, each) for each in specified(text)) + '"'


def argument(text: str) -> str:
    """Write one word of a command line; nothing in it is a variable."""
    return quoted(text.replace("$", "$$"))


def is_acceptable(text: str) -> bool:
    """Whether systemd takes a text at all: UTF-8 without control characters but tab and newline."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return all(each in "\t\n" or (each >= " " and each != "\x7f") for each in text)
