"""Three things that ROS's launch does more often than it needs to, done once.

A command `dump` of Autoware's planning simulator takes 1.3 s of CPU, where launch takes 11 s. The
answers are the same; a test compares them.
"""

from __future__ import annotations

import functools
import sys
from typing import Any

import yaml

from play_launch.launch_files.markup import template


def install(*, only_arguments: bool) -> None:
    """Replace them in the modules of launch; a search for arguments needs the first."""
    if not only_arguments:
        _check_no_arguments_ahead()
    _parse_substitutions_once()
    _read_yaml_by_libyaml()


def _check_no_arguments_ahead() -> None:
    """Skip the search for required arguments in everything below each include.

    It parses the whole tree of includes again at each level, and only raises: a missing argument is
    reported where it is declared.
    """
    from launch import LaunchDescription  # noqa: PLC0415 - not installed everywhere

    def nothing(self: Any, *_: Any, **__: Any) -> list[Any]:  # noqa: ARG001
        return []

    name = "get_launch_arguments_with_include_launch_description_actions"
    if hasattr(LaunchDescription, name):
        setattr(LaunchDescription, name, nothing)


def _parse_substitutions_once() -> None:
    """Parse each text once, and by the Earley parser only where ours may say something else."""
    from launch.frontend import parser  # noqa: PLC0415
    from launch.substitutions import TextSubstitution  # noqa: PLC0415

    module = sys.modules.get("launch.frontend.parse_substitution")
    original = getattr(module, "parse_substitution", None)
    if module is None or original is None:
        return

    @functools.cache
    def once(text: str) -> tuple[Any, ...]:
        return tuple(parsed(text) or original(text))

    def parse_substitution(text: str) -> list[Any]:
        if text and "$" not in text and "\\" not in text:
            return [TextSubstitution(text=text)]
        return list(once(text))

    # The others have it by name.
    for name, other in list(sys.modules.items()):
        if name.split(".")[0] in {"launch", "launch_ros", "launch_xml", "launch_yaml"}:
            for attribute, value in list(vars(other).items()):
                if value is original:
                    setattr(other, attribute, parse_substitution)
    assert parser.parse_substitution is parse_substitution


def parsed(text: str) -> list[Any]:
    """Parse a text by our own parser; nothing where the answer of launch's might be another one.

    Its grammar is ambiguous where something is escaped. Errors are those of launch.
    """
    if "\\" in text or text.count("$") != text.count("$("):
        return []
    try:
        return _made(template.parse(text))
    except Exception:  # noqa: BLE001 - whatever a substitution of the user raises; launch repeats it
        return []


def _made(parts: template.Template) -> list[Any]:
    from launch.frontend.expose import instantiate_substitution  # noqa: PLC0415
    from launch.substitutions import TextSubstitution  # noqa: PLC0415

    found: list[Any] = []
    for part in parts:
        if isinstance(part, str):
            found.append(TextSubstitution(text=part))
        else:
            given = [_made(each) for each in part.arguments]
            found.append(instantiate_substitution(part.name, *([given] if given else [])))
    return found


def _read_yaml_by_libyaml() -> None:
    """Read YAML by libyaml, with what has been added to PyYAML's own safe loader until then."""
    if not hasattr(yaml, "CSafeLoader"):
        return
    loader = type("Loader", (yaml.CSafeLoader,), {})

    def safe_load(stream: Any) -> Any:
        for name in ("yaml_constructors", "yaml_multi_constructors", "yaml_implicit_resolvers"):
            setattr(loader, name, getattr(yaml.SafeLoader, name))
        return yaml.load(stream, loader)  # noqa: S506 - safe

    yaml.safe_load = safe_load
