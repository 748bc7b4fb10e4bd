"""A section is a class with one attribute for each key of a mapping in the file.

The core of pydantic checks the values. Its models would read the same from annotations, but what
reads them takes longer to import than everything else before the first process.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar, Generic, NamedTuple, TypeVar

from pydantic_core import SchemaValidator, ValidationError, core_schema

from play_launch.config.problems import KNOWN, Report, excerpt
from play_launch.config.text import similar
from play_launch.config.tree import Cursor, Mapping, Scalar, ScalarKind, Sequence, describe_node

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import Self

    from pydantic_core import CoreSchema, ErrorDetails

    from play_launch.config.tree import Entry, Node

JsonSchema = dict[str, Any]
Value = TypeVar("Value")
SomeSection = TypeVar("SomeSection", bound="ConfigSection")

_LONGEST_KEY_TO_GUESS = 40
_MOST_GUESSES = 100  # guessing takes long beside everything else; a file with more is no typo
_YAML_1_1_BOOL = {"yes": "true", "on": "true", "y": "true", "no": "false", "off": "false"}
_WRAPPERS = frozenset({"nullable", "function-after"})
_EXPECTED = {
    "string_type": "a string",
    "int_type": "an integer",
    "bool_type": "true or false",
    "list_type": "a list",
    "dict_type": "a mapping",
}


class ValueKind(Generic[Value]):
    """A kind of values: the schema by which pydantic's core checks them, and the JSON Schema."""

    def __init__(self, schema: CoreSchema, form: JsonSchema) -> None:
        self.schema = schema
        self.form = form


class Key(NamedTuple):
    """A key of a section, with what checks its value."""

    schema: CoreSchema
    description: str
    """One or two sentences for editors and the reference."""
    examples: tuple[Any, ...]
    """Values as they are written in the file."""
    form: JsonSchema = {}  # noqa: RUF012 - never changed
    """The value in JSON Schema, where it is no section."""
    required: bool = False
    raw: bool = False
    """Whether the section gets the YAML node in place of a value."""
    section: type[ConfigSection] | None = None
    """The section of the value, or of each item in it where `is_list` or `is_mapping`."""
    is_list: bool = False
    is_mapping: bool = False
    or_name: bool = False
    """Whether a string can stand in place of an item."""
    merging: bool = False
    """Whether it is about included files, and is dropped when these are merged."""


def required(kind: ValueKind[Value], description: str, *examples: object) -> Value:
    """Declare a key that has to be given."""
    key: Any = Key(kind.schema, description, examples, kind.form, required=True)
    return key  # type: ignore[no-any-return]


def optional(kind: ValueKind[Value], description: str, *examples: object) -> Value | None:
    """Declare a key that may be absent or null, which are the same."""
    schema = core_schema.nullable_schema(kind.schema)
    key: Any = Key(schema, description, examples, kind.form)
    return key  # type: ignore[no-any-return]


def raw(form: JsonSchema, description: str, *examples: object, merging: bool = False) -> Any:
    """Declare an optional key whose value is checked where its location is known."""
    schema = core_schema.any_schema()
    return Key(schema, description, examples, form, raw=True, merging=merging)


def listed(
    section: type[ConfigSection], description: str, *examples: object, or_name: bool = False
) -> Any:
    """Declare an optional key with a list of sections, which are checked one by one."""
    key = Key(core_schema.any_schema(), description, examples, raw=True, section=section)
    return key._replace(is_list=True, or_name=or_name)


def mapped(section: type[ConfigSection], description: str, *examples: object) -> Any:
    """Declare an optional key with sections by name, which are checked one by one."""
    key = Key(core_schema.any_schema(), description, examples, raw=True, section=section)
    return key._replace(is_mapping=True)


def nested(section: type[SomeSection], description: str, *examples: object) -> SomeSection | None:
    """Declare an optional key whose value is a mapping with a section of its own."""
    key: Any = Key(core_schema.any_schema(), description, examples, section=section)
    return key  # type: ignore[no-any-return]


class ConfigSection:
    """A mapping of the configuration. A subclass has the keys of its bases after its own."""

    keys: ClassVar[dict[str, Key]] = {}

    def __init_subclass__(cls) -> None:
        own = {name: key for name, key in vars(cls).items() if isinstance(key, Key)}
        for base in reversed(cls.__mro__[1:-1]):
            cls.keys = {**vars(base)["keys"], **cls.keys}
        cls.keys = {**own, **cls.keys}
        for name in own:
            # What an instance has without the key.
            setattr(cls, name, None)

    def __init__(self, values: dict[str, Any] | None = None) -> None:
        vars(self).update(values or {})

    @classmethod
    def of(cls, values: dict[str, Any]) -> Self:
        """Check the values of a mapping; raise pydantic's ValidationError with all mistakes."""
        return cls(cls._validator().validate_python(values))

    @property
    def given(self) -> dict[str, Any]:
        """The keys that stand there, without null."""
        return {name: value for name, value in vars(self).items() if value is not None}

    @classmethod
    @cache
    def _validator(cls) -> SchemaValidator:
        # Made when it is first used: no configuration has all of them.
        fields = {
            name: core_schema.typed_dict_field(key.schema, required=key.required)
            for name, key in cls.keys.items()
        }
        mapping = core_schema.typed_dict_schema(fields, strict=True, extra_behavior="forbid")
        return SchemaValidator(mapping)


def validate_mapping(section: type[SomeSection], at: Cursor) -> SomeSection | None:
    """Return what stands there as `section`, or None after every problem in it was reported."""
    if not isinstance(at.node, Mapping):
        at.expected(f"a mapping ({', '.join(section.keys)})")
        return None
    values: dict[str, object] = {}
    refused = False
    for entry, value in at.entries():
        key = section.keys.get(entry.key)
        if key is not None and key.merging:
            continue
        if key is not None and key.raw:
            values[entry.key] = entry.value
            continue
        if key is not None and key.section is not None:
            values[entry.key] = nested_section = validate_mapping(key.section, value)
            refused |= nested_section is None
            continue
        values[entry.key] = _plain(entry.value, None if key is None else key.schema)
        if key is not None:
            refused |= _refuse_tags(value)
    try:
        checked = section.of(values)
    except ValidationError as error:
        for details in error.errors(include_url=False, include_input=False):
            _report_error(details, section, at)
        return None
    return None if refused else checked


def well_formed(section: type[SomeSection], at: Cursor | None) -> SomeSection | None:
    """Return `section` of the keys whose values are right; None where no mapping stands there.

    Used to go on after a mistake, in a section that requires no key: the other keys still decide
    about mistakes elsewhere.
    """
    if at is None or not isinstance(at.node, Mapping):
        return None
    values: dict[str, Any] = {}
    for entry in at.node.entries:
        alone = Cursor(Mapping(at.node.location, {entry.key: entry}), at.path, Report())
        if (found := validate_mapping(section, alone)) is not None:
            values |= vars(found)
    return section(values)


def items_of(at: Cursor | None, what: str) -> Iterator[Cursor]:
    if at is None:
        return
    if not at.is_plain_list:
        at.expected(f"a list of {what}")
        return
    yield from at.elements()


def entries_of(at: Cursor | None, what: str) -> Iterator[tuple[Entry, Cursor]]:
    if at is None:
        return
    if not isinstance(at.node, Mapping):
        at.expected(f"a mapping of {what}")
        return
    yield from at.entries()


def _plain(node: Node, schema: Any) -> object:
    """Return the value of `node` as pydantic reads it.

    Where `schema` has a string, a substituted value is one.
    """
    while schema is not None and schema["type"] in _WRAPPERS:
        schema = schema["schema"]
    kind = None if schema is None else schema["type"]
    if isinstance(node, Scalar):
        return node.text if node.substituted and kind == "str" else node.value
    if isinstance(node, Sequence):
        items = schema["items_schema"] if kind == "list" else None
        return [_plain(item, items) for item in node.items]
    return {entry.key: _plain(entry.value, None) for entry in node.entries}


def _refuse_tags(at: Cursor) -> bool:
    tag = None
    if isinstance(at.node, Sequence):
        tag = at.node.array_tag
    elif isinstance(at.node, Scalar) and at.node.kind is ScalarKind.BINARY:
        tag = "!!binary"
    if tag is None:
        return False
    at.problem(f"the tag {tag} is for parameters only")
    return True


def _report_error(details: ErrorDetails, section: type[ConfigSection], at: Cursor) -> None:
    key, *steps = details["loc"]
    if details["type"] == "missing":
        at.problem(f"the key {excerpt(str(key))} is missing")
        return
    entry = at.node.by_key[str(key)] if isinstance(at.node, Mapping) else None
    if details["type"] == "extra_forbidden" and entry is not None:
        problem = _unknown_key(entry.key, list(section.keys), at.report)
        at.below(entry.key).problem(problem, entry.location)
        return
    for step in (key, *steps):
        if isinstance(at.node, Mapping) and str(step) in at.node.by_key:
            at = at.below(str(step), at.node.by_key[str(step)].value)
        elif isinstance(at.node, Sequence) and isinstance(step, int):
            at = at.element(step)
    if not at.is_invalid:
        at.problem(_message(details, at.node))


def _unknown_key(key: str, known: list[str], report: Report) -> str:
    if len(key) <= _LONGEST_KEY_TO_GUESS and len(report) < _MOST_GUESSES:
        close = similar(key.lower().replace("-", "_"), known)
        if close:
            return f"unknown key {excerpt(key)}; did you mean {excerpt(close)}?"
    return f"unknown key {excerpt(key)}{KNOWN}{', '.join(known)}"


def _message(details: ErrorDetails, node: Node) -> str:
    kind = details["type"]
    context = details.get("ctx", {})
    if kind == "value_error":
        return str(context["error"])
    if kind in _EXPECTED:
        message = f"expected {_EXPECTED[kind]}, given {describe_node(node)}"
        if isinstance(node, Scalar):
            if kind == "string_type" and node.is_quotable:
                message += f"; quote it: {excerpt(node.text)}"
            if node.substituted and not node.plain:
                message += "; write the substitution without quotes"
            if kind == "bool_type" and node.text.lower() in _YAML_1_1_BOOL:
                message += f"; write {_YAML_1_1_BOOL[node.text.lower()]}"
        return message
    if kind == "greater_than_equal":
        return f"must be at least {context['ge']}, given {describe_node(node)}"
    if kind == "less_than_equal":
        return f"must be at most {context['le']}, given {describe_node(node)}"
    if kind == "too_short":
        return "the list cannot be empty"
    return f"{details['msg']}, given {describe_node(node)}"
