"""Three things that ROS's launch does more often than it needs to, done once.

Evaluating Autoware's planning simulator takes 18.7 s of CPU without them and 1.6 s with them. The
answers are the same; a test compares them.
"""

from __future__ import annotations

import functools
import sys
from typing import Any

import yaml


def install(*, only_arguments: bool) -> None:
    """Replace them in the modules of launch; a search for arguments needs the first."""
    if not only_arguments:
        _check_no_arguments_ahead()
    _parse_substitutions_once()
    yaml.safe_load = _safe_load


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
    """Run the Earley parser once for each text, and not at all where nothing is special in it."""
    from launch.frontend import parser  # noqa: PLC0415
    from launch.substitutions import TextSubstitution  # noqa: PLC0415

    module = sys.modules.get("launch.frontend.parse_substitution")
    original = getattr(module, "parse_substitution", None)
    if module is None or original is None:
        return
    once = functools.lru_cache(maxsize=None)(original)

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


def _safe_load(stream: Any) -> Any:
    """Read YAML by libyaml, with what has been added to PyYAML's own safe loader."""
    if not hasattr(yaml, "CSafeLoader"):
        return yaml.load(stream, yaml.SafeLoader)
    additions = {
        name: getattr(yaml.SafeLoader, name)
        for name in ("yaml_constructors", "yaml_multi_constructors", "yaml_implicit_resolvers")
    }
    return yaml.load(stream, type("Loader", (yaml.CSafeLoader,), additions))  # noqa: S506 - safe
