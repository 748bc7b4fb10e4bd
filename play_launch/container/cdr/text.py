"""Text in a CDR string."""

from __future__ import annotations


def text_bytes(text: str) -> bytes:
    r"""Encode text for a CDR string, which can hold neither NUL nor half of a surrogate pair.

    Both are written as escapes (``\x00``, ``\udc80``), so that nothing disappears.
    """
    try:
        data = text.encode()
    except UnicodeEncodeError:
        data = text.encode("utf-8", "backslashreplace")
    return data.replace(b"\0", b"\\x00") if b"\0" in data else data
