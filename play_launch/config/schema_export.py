"""The JSON Schema of the configuration, derived from the sections in `schema`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from play_launch.config import schema
from play_launch.config.resource_values import HIGHEST_CPU

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pydantic_core import CoreSchema

    from play_launch.config.section import Key, Section

JsonSchema = dict[str, Any]

_DIALECT: Final = "http://json-schema.org/draft-07/schema#"
"""What the language server for YAML knows best."""
_DESCRIPTION: Final = "A configuration of play-launch; `play-launch check` finds every mistake."
_DEEPER: Final = frozenset({"ComposableNodeSection", "ProcessSection"})
"""Sections in which nothing is required: an entry may be merged with an included one."""

_SUBSTITUTION: Final[JsonSchema] = {"type": "string", "pattern": r"\$[{(]"}
"""What stands in place of a number or a truth value and becomes one."""
_NUMBER_AND_UNIT: Final = r"^\s*([-+]?([0-9]+(\.[0-9]*)?|\.[0-9]+))\s*"
_CPU_LIST: Final = r"^\s*[0-9]{1,4}(-[0-9]{1,4})?(\s*,\s*[0-9]{1,4}(-[0-9]{1,4})?)*\s*$"
_SHAPES: Final[Mapping[str, JsonSchema]] = {
    "duration": {
        "anyOf": [
            {"type": "number", "minimum": 0},
            {"type": "string", "pattern": rf"{_NUMBER_AND_UNIT}(us|ms|s|min|h)?\s*$"},
            _SUBSTITUTION,
        ]
    },
    "size": {
        "anyOf": [
            {"type": "number", "exclusiveMinimum": 0},
            {"type": "string", "pattern": rf"{_NUMBER_AND_UNIT}([kMGT]?B|[KMGT]iB)?\s*$"},
            _SUBSTITUTION,
        ]
    },
    "never": {"const": "never"},
    "unlimited": {"const": "unlimited"},
    "count": {"anyOf": [{"type": "integer"}, _SUBSTITUTION]},
    "pair": {"type": "string", "pattern": r"^[^:$]+:[^:]+$"},
    "cpus": {
        "anyOf": [
            {"type": "integer", "minimum": 0, "maximum": HIGHEST_CPU},
            {"type": "string", "pattern": _CPU_LIST},
            {
                "type": "array",
                "minItems": 1,
                "items": {
                    "anyOf": [
                        {"type": "integer", "minimum": 0, "maximum": HIGHEST_CPU},
                        {"type": "string", "pattern": _CPU_LIST},
                    ]
                },
            },
            _SUBSTITUTION,
        ]
    },
    "max": {"const": "max"},
    "cpu_max": {
        "anyOf": [
            {"type": "string", "pattern": r"^\s*([0-9.]+\s*%|max|(max|[0-9]+)\s+[0-9]+)\s*$"},
            _SUBSTITUTION,
        ]
    },
    "group_path": {
        "anyOf": [{"const": "auto"}, {"type": "string", "pattern": "^/"}, _SUBSTITUTION]
    },
    "io_priority": {
        "anyOf": [
            {"type": "string", "pattern": r"^(idle|(best_effort|realtime)(:[0-7])?)$"},
            _SUBSTITUTION,
        ]
    },
    "words": {"anyOf": [{"type": "string"}, {"type": "array", "items": {"type": "string"}}]},
}
_SCALAR: Final[JsonSchema] = {"type": ["string", "number", "boolean"]}
_PARAMETERS: Final[JsonSchema] = {"type": "object"}
_SECTIONS: Final[JsonSchema] = {"type": "object", "additionalProperties": _PARAMETERS}
_ENTRY_OR_LIST: Final[JsonSchema] = {
    "anyOf": [
        {"type": "string"},
        {
            "type": "object",
            "required": ["file"],
            "properties": {
                "file": {"type": "string"},
                "arguments": {"type": "object", "additionalProperties": _SCALAR},
            },
            "additionalProperties": False,
        },
    ]
}

_RAW: Final[Mapping[str, JsonSchema]] = {
    "environment": {"type": "object", "additionalProperties": {"type": "string"}},
    "parameters": {
        "anyOf": [
            _PARAMETERS,
            {"type": "array", "items": {"anyOf": [{"type": "string"}, _PARAMETERS]}},
        ]
    },
    "process_parameters": {
        "anyOf": [
            _SECTIONS,
            {"type": "array", "items": {"anyOf": [{"type": "string"}, _SECTIONS]}},
        ]
    },
    "extra_arguments": {"anyOf": [_PARAMETERS, {"type": "array", "items": _PARAMETERS}]},
    "remappings": {
        "anyOf": [
            {"type": "object", "additionalProperties": {"type": "string"}},
            {
                "type": "array",
                "items": {
                    "anyOf": [
                        {"type": "string"},
                        {"type": "array", "items": {"type": "string"}, "minItems": 2},
                        {"type": "object", "required": ["from", "to"]},
                    ]
                },
            },
        ]
    },
    "per_node": {
        "type": "object",
        "additionalProperties": {"$ref": "#/definitions/grouplimits"},
    },
    "include": {"anyOf": [*_ENTRY_OR_LIST["anyOf"], {"type": "array", "items": _ENTRY_OR_LIST}]},
}
"""Keys that are checked with their locations at hand."""
_LISTS: Final[Mapping[str, str]] = {
    "containers": "ContainerSection",
    "composable_nodes": "ComposableNodeSection",
    "nodes": "ProcessSection",
}
"""Keys with a list of sections, by the name of the section."""
_OR_NAMES: Final[Mapping[str, type[Section]]] = {"depends_on": schema.DependencySection}
"""Keys with a list of sections, or of names in their place."""


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
    properties = {}
    for name, key in section.keys.items():
        examples = {"examples": list(key.examples)} if key.examples else {}
        properties[name] = {
            "description": key.description,
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
    if name in _LISTS:
        return {
            "type": "array",
            "items": _reference(getattr(schema, _LISTS[name]), definitions),
        }
    if name in _OR_NAMES:
        entry = _reference(_OR_NAMES[name], definitions)
        return {"type": "array", "items": {"anyOf": [{"type": "string"}, entry]}}
    return _RAW[name] if key.raw else _value_schema(key.schema)


def _reference(section: type[Section], definitions: dict[str, Any]) -> JsonSchema:
    name = section.__name__.removesuffix("Section").lower()
    if name not in definitions:
        definitions[name] = None
        definitions[name] = _section(section, definitions)
    # Beside a reference nothing else is read in this dialect.
    return {"allOf": [{"$ref": f"#/definitions/{name}"}]}


def _value_schema(schema: CoreSchema) -> JsonSchema:
    """Return what the core schema of a key accepts; raise KeyError where that is not known."""
    core: Mapping[str, Any] = schema
    match core["type"]:
        case "nullable" | "function-after":
            return _value_schema(core["schema"])
        case "str":
            return {"type": "string"}
        case "bool":
            return {"anyOf": [{"type": "boolean"}, _SUBSTITUTION]}
        case "int":
            bounds = {"minimum": core.get("ge"), "maximum": core.get("le")}
            limits = {name: bound for name, bound in bounds.items() if bound is not None}
            return {"anyOf": [{"type": "integer", **limits}, _SUBSTITUTION]}
        case "list":
            least = {"minItems": core["min_length"]} if core.get("min_length") else {}
            return {"type": "array", "items": _value_schema(core["items_schema"]), **least}
        case "function-wrap":
            # What the wrapped schema is not, the function reads as a size.
            return {"anyOf": [_SHAPES["size"], _value_schema(core["schema"])]}
        case "dict":
            return {"type": "object", "additionalProperties": _value_schema(core["values_schema"])}
        case _:
            return _parsed(core["metadata"])


def _parsed(about: Mapping[str, Any]) -> JsonSchema:
    choices = about.get("choices")
    if choices is not None:
        words = [str(choice) for choice in choices]
        forms: list[JsonSchema] = [{"enum": words}, _SUBSTITUTION]
        if about.get("upper_case"):
            upper = "|".join(word.upper() for word in words)
            forms.append({"type": "string", "pattern": f"^({upper})$"})
        return {"anyOf": forms}
    shapes = [_SHAPES[shape] for shape in about["shape"].split(" or ")]
    return shapes[0] if len(shapes) == 1 else {"anyOf": shapes}
