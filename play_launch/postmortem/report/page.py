"""The page: one HTML file with everything in it, which needs no network and allows none."""

from __future__ import annotations

import base64
import hashlib
import html
import re
from importlib.resources import files
from typing import TYPE_CHECKING, Final

import msgspec

if TYPE_CHECKING:
    from play_launch.postmortem.report.facts import Contents

SCRIPTS: Final = (
    *("unpack.js", "format.js", "theme.js", "axis.js", "columns.js", "timeline.js", "plots.js"),
    *("log.js", "failures.js", "tables.js", "keys.js", "start.js"),
)
"""In the order in which they use one another."""
_ASSETS: Final = files("play_launch.postmortem.report") / "assets"
_PLACE: Final = re.compile(r"\{\{(\w+)\}\}")

_ESCAPES: Final = re.compile(
    r"\x1b(?:\[[0-?]*[ -/]*[@-~]|\][^\x07\x1b]*(?:\x07|\x1b\\)?|[PX^_][^\x1b]*(?:\x1b\\)?"
    r"|[^\[\]PX^_])"
)
"""What colours a terminal or moves its cursor: it means nothing on a page."""
_C0: Final = {code: chr(0x2400 + code) for code in range(0x20) if chr(code) not in "\t\n"}
_C1: Final = {code: f"\\x{code:02x}" for code in range(0x80, 0xA0)}
_INVISIBLE: Final = {
    # Marks that set or change the direction of text, line separators, and the like.
    code: f"\\u{code:04x}"
    for code in (0x061C, 0x200E, 0x200F, *range(0x2028, 0x202F), *range(0x2066, 0x206A), 0xFEFF)
}
_NO_TEXT: Final = {code: f"\\u{code:04x}" for code in range(0xD800, 0xE000)}
"""Bytes of a file's name that are no UTF-8, as Python reads them: they cannot be written."""
_PICTURES: Final = {**_C0, 0x7F: "\u2421", **_C1, **_INVISIBLE, **_NO_TEXT}


def shown(text: str) -> str:
    r"""Give text without colours, and with what is invisible made visible; ``\n`` and tabs stay."""
    if text.isprintable():
        return text
    if "\x1b" in text:
        text = _ESCAPES.sub("", text)
    return text.translate(_PICTURES)


def render(page: Contents) -> str:
    dark = _asset("dark.css").replace(":root", ':root[data-theme="dark"]')
    script = '"use strict";\n' + "".join(map(_asset, SCRIPTS))
    parts = {
        "title": html.escape(page.facts.title),
        "script": script,
        "script_hash": _hash(script),
        "facts": embedded(msgspec.json.encode(page.facts).decode()),
        "columns": "\n".join(
            f'<script type="text/plain" id="{name}">{text}</script>'
            for name, text in page.columns.items()
        ),
    }
    style = _asset("page.css") + dark
    parts = {**parts, "style": style, "style_hash": _hash(style)}
    # In one pass: what is put in is not looked through again.
    return _PLACE.sub(lambda place: parts[place[1]], _asset("page.html"))


def embedded(json_text: str) -> str:
    r"""Give JSON as it can stand in a ``<script>``: nothing in it begins a tag or a comment."""
    return json_text.replace("<", "\\u003c").replace(">", "\\u003e")


def _asset(name: str) -> str:
    return (_ASSETS / name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")
