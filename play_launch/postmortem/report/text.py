"""Foreign text as a page can show it: nothing invisible, nothing that rearranges what is around."""

from __future__ import annotations

import re
from typing import Final

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
