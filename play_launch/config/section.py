"""What a section is: a class with one attribute for each key of a mapping in the file.

The core of pydantic checks the values. Its models would read the same from annotations, but what
reads them takes longer to import than everything else before the first process.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from pydantic_core import SchemaValidator, core_schema

if TYPE_CHECKING:
    from collections.abc import Mapping
    from typing import Self

    from pydantic_core import CoreSchema


class Key(NamedTuple):
    """A key of a section: what checks its value, or the section of the mapping that is its value.

    A raw key gets the YAML node instead of a value. A `merging` key is about included files and is
    dropped when these are merged.
    """

    schema: CoreSchema
    description: str
    """One or two sentences for editors and the reference."""
    examples: tuple[Any, ...] = ()
    """Values as they are written in the file."""
    required: bool = False
    raw: bool = False
    section: type[Section] | None = None
    merging: bool = False


def required(schema: CoreSchema, description: str, *examples: object) -> Any:
    """Declare a key that has to be given."""
    return Key(schema, description, examples, required=True)


def optional(schema: CoreSchema, description: str, *examples: object) -> Any:
    """Declare a key that may be absent or null, which are the same."""
    return Key(core_schema.nullable_schema(schema), description, examples)


def raw(description: str, *examples: object) -> Any:
    """Declare an optional key whose value is checked where its location is known."""
    return Key(core_schema.any_schema(), description, examples, raw=True)


def merging(description: str, *examples: object) -> Any:
    """Declare a key about included files."""
    return Key(core_schema.any_schema(), description, examples, raw=True, merging=True)


def nested(section: type[Section], description: str, *examples: object) -> Any:
    """Declare an optional key whose value is a mapping with a section of its own."""
    schema = core_schema.nullable_schema(section.schema())
    return Key(schema, description, examples, section=section)


class Section:
    """A mapping of the configuration. A subclass has the keys of its base after its own."""

    keys: ClassVar[Mapping[str, Key]] = {}

    def __init_subclass__(cls) -> None:
        own = {name: key for name, key in vars(cls).items() if isinstance(key, Key)}
        cls.keys = {**own, **cls.keys}
        for name in own:
            # What an instance has without the key.
            setattr(cls, name, None)

    def __init__(self, values: Mapping[str, object] | None = None) -> None:
        vars(self).update(values or {})

    @classmethod
    def of(cls, values: Mapping[str, object]) -> Self:
        """Check the values of a mapping; raise pydantic's ValidationError with all mistakes."""
        section: Self = cls._validator().validate_python(values)
        return section

    @property
    def given(self) -> dict[str, Any]:
        """The keys that stand there, without null."""
        return {name: value for name, value in vars(self).items() if value is not None}

    @classmethod
    def schema(cls) -> CoreSchema:
        """Return what checks the mapping and makes an instance of it."""
        fields = {
            name: core_schema.typed_dict_field(key.schema, required=key.required)
            for name, key in cls.keys.items()
        }
        mapping = core_schema.typed_dict_schema(fields, strict=True, extra_behavior="forbid")
        return core_schema.no_info_after_validator_function(cls, mapping)

    @classmethod
    @cache
    def _validator(cls) -> SchemaValidator:
        # Made when it is first used: no configuration has all of them.
        return SchemaValidator(cls.schema())
