"""Checks values against a JSON Schema: those of its words that our schema uses, and no others."""

from __future__ import annotations

import re
from typing import Any

_TYPES: dict[str, Any] = {
    "object": dict,
    "array": list,
    "string": str,
    "boolean": bool,
    "number": (int, float),
    "integer": int,
}
_WORDS = {
    *("$schema", "title", "description", "examples", "definitions", "type", "properties"),
    *("required", "additionalProperties", "items", "minItems", "minimum", "maximum"),
    *("exclusiveMinimum", "pattern", "enum", "const", "anyOf", "allOf", "$ref"),
}


def problems(value: Any, schema: Any, root: Any = None) -> list[str]:
    """Return what is wrong with a value; words that are not known are."""
    root = schema if root is None else root
    found = [f"unknown word {word}" for word in schema.keys() - _WORDS]
    if "$ref" in schema:
        found += problems(value, root["definitions"][schema["$ref"].rpartition("/")[2]], root)
    for each in schema.get("allOf", ()):
        found += problems(value, each, root)
    if "anyOf" in schema and all(problems(value, each, root) for each in schema["anyOf"]):
        found.append(f"{value!r} fits nothing of {schema['anyOf']}")
    if "const" in schema and not _same(value, schema["const"]):
        found.append(f"{value!r} is not {schema['const']!r}")
    if "enum" in schema and value not in schema["enum"]:
        found.append(f"{value!r} is not in {schema['enum']}")
    kinds = schema.get("type", ())
    if kinds and not any(
        _is(value, kind) for kind in ([kinds] if isinstance(kinds, str) else kinds)
    ):
        return [*found, f"{value!r} is not of type {kinds}"]
    return found + list(_parts(value, schema, root))


def _is(value: Any, kind: str) -> bool:
    if isinstance(value, bool):
        return kind == "boolean"
    return isinstance(value, _TYPES[kind])


def _same(value: Any, constant: Any) -> bool:
    return type(value) is type(constant) and value == constant


def _parts(value: Any, schema: Any, root: Any) -> list[str]:
    found: list[str] = []
    if isinstance(value, str) and not re.search(schema.get("pattern", ""), value):
        found.append(f"{value!r} does not match {schema['pattern']}")
    if isinstance(value, int | float) and not isinstance(value, bool):
        if value < schema.get("minimum", value) or value > schema.get("maximum", value):
            found.append(f"{value!r} is out of bounds")
        if "exclusiveMinimum" in schema and value <= schema["exclusiveMinimum"]:
            found.append(f"{value!r} is too small")
    if isinstance(value, list):
        if len(value) < schema.get("minItems", 0):
            found.append("too short")
        for item in value if "items" in schema else ():
            found += problems(item, schema["items"], root)
    if isinstance(value, dict):
        found += [f"{key} is missing" for key in schema.get("required", ()) if key not in value]
        more = schema.get("additionalProperties", True)
        for key, each in value.items():
            if key in schema.get("properties", {}):
                found += problems(each, schema["properties"][key], root)
            elif more is False:
                found.append(f"unknown key {key}")
            elif more is not True:
                found += problems(each, more, root)
    return found
