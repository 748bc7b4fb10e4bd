"""Launch files as launch reads them, with a note of where each part stands."""

from __future__ import annotations

import functools
import importlib
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from xml.etree import ElementTree as ET

import launch
import launch.frontend
import yaml
from launch_ros.descriptions import ComposableNode

from play_launch.launch_files.records import Place
from play_launch.launch_files.ros_launch.places import xml_lines, yaml_lines

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.launch_files.ros_launch.places import Places

_FUNCTION: Final = "generate_launch_description"


def install(places: Places) -> None:
    """Replace what reads launch files, for this process."""
    _python(places)
    _frontends(places)
    _made(places)


def _python(places: Places) -> None:
    module = importlib.import_module(
        "launch.launch_description_sources.python_launch_file_utilities"
    )
    load = module.load_python_launch_file_as_module

    def load_python_launch_file_as_module(path: str) -> Any:
        places.file_read(path)
        with places.no_parsing():
            found = load(path)
        if hasattr(found, _FUNCTION):
            setattr(found, _FUNCTION, _checked(getattr(found, _FUNCTION)))
        return found

    module.load_python_launch_file_as_module = load_python_launch_file_as_module  # type: ignore[attr-defined]


def _checked(generate: Callable[[], Any]) -> Callable[[], Any]:
    """Refuse what launch would take and fail on later."""

    @functools.wraps(generate)
    def generate_launch_description() -> Any:
        found = generate()
        if not isinstance(found, launch.LaunchDescription):
            raise TypeError(f"{_FUNCTION}() returns {found!r} and no LaunchDescription")
        return found

    return generate_launch_description


def _made(places: Places) -> None:
    """Note where actions and composable nodes are made."""
    for kind in (launch.Action, ComposableNode):
        _note_construction(places, kind)


def _note_construction(places: Places, kind: Any) -> None:
    construct = kind.__init__

    def __init__(self: Any, *arguments: Any, **named: Any) -> None:  # noqa: N807
        places.made(self)
        construct(self, *arguments, **named)

    kind.__init__ = __init__


def _frontends(places: Places) -> None:
    base = launch.frontend.Parser
    base.load_parser_implementations()
    for implementation in base.frontend_parsers.values():
        _note_lines(places, implementation)
    parse_action = base.parse_action

    def parse(self: Any, entity: Any) -> Any:
        with places.parsing(_of_entity(places, entity)):
            return parse_action(self, entity)

    base.parse_action = parse
    parse_node = ComposableNode.parse.__func__

    def parse_composable(cls: Any, parser: Any, entity: Any) -> Any:
        # The caller makes the node afterwards, where only the place of the container is known.
        place = _of_entity(places, entity)
        with places.parsing(place):
            kind, named = parse_node(cls, parser, entity)

        def make(**arguments: Any) -> Any:
            with places.parsing(place):
                return kind(**arguments)

        return make, named

    ComposableNode.parse = classmethod(parse_composable)


def _note_lines(places: Places, implementation: Any) -> None:
    load: Callable[..., Any] = implementation.load.__func__

    def load_and_note(cls: Any, file: Any) -> Any:
        path = str(getattr(file, "name", file))
        try:
            entity, parser = load(cls, file)
        except (AttributeError, KeyError, TypeError) as error:
            # launch_yaml takes for granted what a file looks like.
            wrong = RuntimeError("a launch file is one key `launch` above a list")
            places.annotate(wrong, Place(str(Path(path).absolute())))
            raise wrong from error
        places.file_read(path)
        content = Path(path).read_bytes() if Path(path).is_file() else b""
        with suppress(Exception):  # the file was read; only its lines are not known
            _note_elements(places, entity, str(Path(path).absolute()), content)
        return entity, parser

    implementation.load = classmethod(load_and_note)


def _note_elements(places: Places, entity: Any, path: str, content: bytes) -> None:
    root = _element(entity)
    if isinstance(root, ET.Element):
        for element, line in zip(root.iter(), xml_lines(content), strict=True):
            places.element_read(element, Place(path, line))
    else:
        node = yaml.compose(content, yaml.CSafeLoader)
        if node is not None:
            below = node.value[0][1]
            for value, line in yaml_lines(below, root):
                places.element_read(value, Place(path, line))


def _element(entity: Any) -> Any:
    """Return what an entity of launch_xml or launch_yaml stands for."""
    kind = type(entity).__name__
    for name in ("xml_element", "element"):
        found = getattr(entity, f"_{kind}__{name}", None)
        if found is not None:
            return found
    return None


def _of_entity(places: Places, entity: Any) -> Place:
    return places.of_element(_element(entity))
