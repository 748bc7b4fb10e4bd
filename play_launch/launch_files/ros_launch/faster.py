"""What ROS's launch does more often than it needs to, done once.

The answers are the same; a test compares them. The figures are in `docs/benchmarks.md`.
"""

from __future__ import annotations

import functools
import importlib.metadata
import io
import pickle
import sys
from typing import Any, Final

import yaml

_REMEMBERED: Final = 256
"""How many texts in YAML are kept with what they mean."""


def install(*, only_arguments: bool) -> None:
    """Replace it in the modules of launch; a search for arguments needs the first."""
    if not only_arguments:
        _check_no_arguments_ahead()
    _parse_substitutions_once()
    _read_yaml_by_libyaml()
    _write_yaml_by_libyaml()
    # Of all packages of Python, for each kind of extension again.
    once = functools.cache(importlib.metadata.entry_points)
    importlib.metadata.entry_points = once  # type: ignore[assignment] # overloads


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
    """Parse each text once: the Earley parser takes 0.2 to 1 ms for one."""
    from launch.frontend import parser  # noqa: PLC0415
    from launch.substitutions import TextSubstitution  # noqa: PLC0415

    module = sys.modules.get("launch.frontend.parse_substitution")
    original = getattr(module, "parse_substitution", None)
    if module is None or original is None:
        return

    @functools.cache
    def once(text: str) -> tuple[Any, ...]:
        return tuple(original(text))

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


def _read_yaml_by_libyaml() -> None:
    """Read YAML by libyaml, each text once: a parameter file is read for each node that gets it.

    What has been added to PyYAML's own safe loader until then is known here as well.
    """
    if not hasattr(yaml, "CSafeLoader"):
        return
    loader = type("Loader", (yaml.CSafeLoader,), {})

    def load(stream: Any) -> Any:
        for name in ("yaml_constructors", "yaml_multi_constructors", "yaml_implicit_resolvers"):
            setattr(loader, name, getattr(yaml.SafeLoader, name))
        return yaml.load(stream, loader)  # noqa: S506 - safe

    @functools.lru_cache(_REMEMBERED)
    def loaded(text: str) -> bytes:
        return pickle.dumps(load(text))

    def safe_load(stream: Any) -> Any:
        text = stream.read() if isinstance(stream, io.TextIOWrapper) else stream
        if not isinstance(text, str):
            return load(stream)
        try:
            # A copy for each caller, which may change it.
            return pickle.loads(loaded(text))  # noqa: S301 - ours
        except Exception:  # noqa: BLE001 - errors are those of PyYAML, with the name of the file
            if text is not stream:
                stream.seek(0)
            return load(stream)

    yaml.safe_load = safe_load


def _write_yaml_by_libyaml() -> None:
    """Write YAML by libyaml, as launch_ros does with the parameters of each node."""
    if not hasattr(yaml, "CDumper"):
        return
    dumper: Any = type("Dumper", (yaml.CDumper,), {})
    dump = yaml.dump

    @functools.wraps(dump)
    def dump_by_libyaml(data: Any, stream: Any = None, Dumper: Any = None, **named: Any) -> Any:  # noqa: N803
        for name in ("yaml_representers", "yaml_multi_representers", "yaml_implicit_resolvers"):
            setattr(dumper, name, getattr(yaml.Dumper, name))
        return dump(data, stream, dumper if Dumper in {None, yaml.Dumper} else Dumper, **named)

    yaml.dump = dump_by_libyaml
