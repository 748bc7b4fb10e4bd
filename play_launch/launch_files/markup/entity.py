"""Launch files as trees of entities, each with its place; XML and YAML give the same."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final
from xml.parsers import expat

import yaml
from msgspec import Struct, field

from play_launch.launch_files.markup.trouble import Trouble
from play_launch.launch_files.records import Place

if TYPE_CHECKING:
    from collections.abc import Iterator

MOST_ENTITIES: Final = 100_000
"""Of a file, those that aliases of YAML repeat counted as often as they stand there."""
_MOST_LEVELS: Final = 100
_CHILDREN: Final = "children"


class Entity(Struct):
    """A tag with its attributes; `below` are nested tags in their order.

    Attributes of XML are texts. Those of YAML are what YAML 1.1 makes of them, as in launch.
    """

    tag: str
    place: Place
    is_typed: bool = False
    attributes: dict[str, Any] = field(default_factory=dict)
    below: list[Entity] = field(default_factory=list)

    def nested(self, tag: str) -> Iterator[Entity]:
        """Yield the nested entities of one tag."""
        return (each for each in self.below if each.tag == tag)


def read_entity(text: str, path: str) -> Entity:
    """Return the root of a launch file.

    Raises:
        Trouble: When it is neither XML nor YAML, with the place.
    """
    if path.endswith((".yaml", ".yml")) or (
        not path.endswith(".xml") and not text.lstrip("\ufeff \t\r\n").startswith("<")
    ):
        root = _read_yaml(text, path)
    else:
        root = _read_xml(text, path)
    if root.tag != "launch":
        raise Trouble(f"expected launch at the top, given {root.tag}", root.place)
    return root


def _read_xml(text: str, path: str) -> Entity:
    parser = expat.ParserCreate()
    top = Entity("", Place(path))
    stack = [top]

    def begin(tag: str, attributes: dict[str, str]) -> None:
        entity = Entity(tag, Place(path, parser.CurrentLineNumber), attributes=attributes)
        if len(stack) > _MOST_LEVELS:
            raise Trouble("nested too deeply", entity.place)
        stack[-1].below.append(entity)
        stack.append(entity)

    def end(_: str) -> None:
        stack.pop()

    parser.StartElementHandler = begin
    parser.EndElementHandler = end
    try:
        parser.Parse(text.encode(), True)
    except expat.ExpatError as error:
        reason = expat.ErrorString(error.code)
        raise Trouble(f"is not XML: {reason}", Place(path, error.lineno)) from error
    return top.below[0]


def _read_yaml(text: str, path: str) -> Entity:
    start = Place(path, 1)
    try:
        root = yaml.compose(text, Loader=yaml.SafeLoader)
        return _Yaml(path).only(root, start)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark is not None else 0
        raise Trouble(f"is not YAML: {error.problem}", Place(path, line)) from error
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise Trouble(f"is not YAML: {error}", start) from error


class _Yaml:
    def __init__(self, path: str) -> None:
        self._path = path
        self._constructor = yaml.SafeLoader("")
        self._count = 0

    def only(self, node: yaml.Node | None, place: Place) -> Entity:
        """Return the entity of a mapping with one key, which is the tag."""
        if not isinstance(node, yaml.MappingNode) or len(node.value) != 1:
            given = place if node is None else self._place(node)
            raise Trouble("expected a mapping with one key, which is the kind of entity", given)
        key, value = node.value[0]
        return self._entity(str(key.value), value, self._place(key))

    def _entity(self, tag: str, node: yaml.Node, place: Place) -> Entity:
        self._count += 1
        if self._count > MOST_ENTITIES:
            raise Trouble(f"more than {MOST_ENTITIES} entities", place)
        entity = Entity(tag, place, is_typed=True)
        if isinstance(node, yaml.SequenceNode):
            entity.below = [self.only(each, place) for each in node.value]
        elif isinstance(node, yaml.MappingNode):
            for key, value in node.value:
                self._add(entity, str(key.value), value)
        else:
            raise Trouble(f"expected a mapping or a list below {tag}", self._place(node))
        return entity

    def _add(self, entity: Entity, key: str, node: yaml.Node) -> None:
        items = node.value if isinstance(node, yaml.SequenceNode) else []
        if key == _CHILDREN:
            if not isinstance(node, yaml.SequenceNode):
                raise Trouble("expected a list of entities", self._place(node))
            entity.below += [self.only(each, entity.place) for each in items]
        elif items and all(isinstance(each, yaml.MappingNode) for each in items):
            entity.below += [self._entity(key, each, self._place(each)) for each in items]
        elif key in entity.attributes:
            raise Trouble(f"{key} is given twice", self._place(node))
        else:
            entity.attributes[key] = self._constructor.construct_object(node, deep=True)

    def _place(self, node: yaml.Node) -> Place:
        return Place(self._path, node.start_mark.line + 1)
