"""The JSON Schema of the configuration, derived from the sections in `schema`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from play_launch.config.kinds import STRING_FORM, any_of, list_form, mapping_form
from play_launch.config.schema import DocumentSection

if TYPE_CHECKING:
    from play_launch.config.section import ConfigSection, JsonSchema, Key

_MERGED: Final = frozenset({"ComposableNodeSection", "ProcessSection"})
"""Sections in which nothing is required: an entry may be merged with an included one."""


def json_schema() -> dict[str, Any]:
    """Return the schema as JSON values, in the dialect that the YAML language server prefers."""
    definitions: dict[str, Any] = {}
    root = _section(DocumentSection, definitions)
    return {
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": "play-launch",
        "description": "A configuration of play-launch; `play-launch check` finds every mistake.",
        **root,
        "definitions": dict(sorted(definitions.items())),
    }


def _section(section: type[ConfigSection], definitions: dict[str, Any]) -> JsonSchema:
    properties = {}
    for name, key in section.keys.items():
        examples = {"examples": list(key.examples)} if key.examples else {}
        form = _form(key, definitions)
        properties[name] = {"description": key.description, **examples, **form}
    required = [name for name, key in section.keys.items() if key.required]
    return {
        "type": "object",
        "properties": properties,
        **({"required": required} if required and section.__name__ not in _MERGED else {}),
        "additionalProperties": False,
    }


def _form(key: Key, definitions: dict[str, Any]) -> JsonSchema:
    if key.section is None:
        return key.form
    name = key.section.__name__.removesuffix("Section").lower()
    if name not in definitions:
        definitions[name] = None
        definitions[name] = _section(key.section, definitions)
    # Beside a reference nothing else is read in this dialect.
    reference = {"allOf": [{"$ref": f"#/definitions/{name}"}]}
    if key.is_mapping:
        return mapping_form(reference)
    if not key.is_list:
        return reference
    return list_form(any_of(STRING_FORM, reference) if key.or_name else reference)
