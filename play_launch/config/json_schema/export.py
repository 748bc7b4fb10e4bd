"""The JSON Schema of the whole file, made of the sections and of their texts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from play_launch.config import schema
from play_launch.config.json_schema.texts import TEXTS
from play_launch.config.json_schema.types import LISTS, OR_NAMES, RAW, value_schema

if TYPE_CHECKING:
    from play_launch.config.json_schema.types import JsonSchema
    from play_launch.config.section import Key, Section

_DIALECT: Final = "http://json-schema.org/draft-07/schema#"
"""What the language server for YAML knows best."""
_DESCRIPTION: Final = "A configuration of play-launch; `play-launch check` finds every mistake."
_DEEPER: Final = frozenset({"ComposableNodeSection", "ProcessSection"})
"""Sections in which nothing is required: an entry may be merged with an included one."""


def json_schema() -> dict[str, Any]:
    """Return the schema, as JSON values."""
    definitions: dict[str, Any] = {}
    root = _section(schema.DocumentSection, definitions)
    return {
        "$schema": _DIALECT,
        "title": "play-launch",
        "description": _DESCRIPTION,
        **root,
        "definitions": dict(sorted(definitions.items())),
    }


def _section(section: type[Section], definitions: dict[str, Any]) -> JsonSchema:
    texts = TEXTS[section.__name__]
    properties = {}
    for name, key in section.keys.items():
        about = texts[name]
        examples = {"examples": list(about.examples)} if about.examples else {}
        properties[name] = {
            "description": about.description,
            **examples,
            **_key(name, key, definitions),
        }
    required = [
        name
        for name, key in section.keys.items()
        if key.required and section.__name__ not in _DEEPER
    ]
    return {
        "type": "object",
        "properties": properties,
        **({"required": required} if required else {}),
        "additionalProperties": False,
    }


def _key(name: str, key: Key, definitions: dict[str, Any]) -> JsonSchema:
    if key.section is not None:
        return _reference(key.section, definitions)
    if name in LISTS:
        return {
            "type": "array",
            "items": _reference(getattr(schema, LISTS[name]), definitions),
        }
    if name in OR_NAMES:
        entry = _reference(OR_NAMES[name], definitions)
        return {"type": "array", "items": {"anyOf": [{"type": "string"}, entry]}}
    return RAW[name] if key.raw else value_schema(key.schema)


def _reference(section: type[Section], definitions: dict[str, Any]) -> JsonSchema:
    name = section.__name__.removesuffix("Section").lower()
    if name not in definitions:
        definitions[name] = None
        definitions[name] = _section(section, definitions)
    # Beside a reference nothing else is read in this dialect.
    return {"allOf": [{"$ref": f"#/definitions/{name}"}]}
