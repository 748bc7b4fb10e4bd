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


def render(page: Contents) -> str:
    """Give the HTML."""
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
    return _filled("page.html", _asset("page.css") + dark, parts)


def render_without_script(template: str, title: str, body: str) -> str:
    """Give the HTML of a page that is dark where the browser is, and light on paper.

    ``title`` is text, ``body`` is HTML.
    """
    dark = f"@media screen and (prefers-color-scheme: dark) {{\n{_asset('dark.css')}}}\n"
    parts = {"title": html.escape(title), "body": body}
    return _filled(template, _asset("page.css") + dark, parts)


def _filled(template: str, style: str, parts: dict[str, str]) -> str:
    parts = {**parts, "style": style, "style_hash": _hash(style)}
    # In one pass: what is put in is not looked through again.
    return _PLACE.sub(lambda place: parts[place[1]], _asset(template))


def embedded(json_text: str) -> str:
    r"""Give JSON as it can stand in a ``<script>``: nothing in it begins a tag or a comment."""
    return json_text.replace("<", "\\u003c").replace(">", "\\u003e")


def _asset(name: str) -> str:
    return (_ASSETS / name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")
