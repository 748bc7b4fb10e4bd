"""The releases of ros2cli that the overlay fits, known by number and by what their code does.

The overlay replaces or leans on the definitions listed here. Each is known by a digest of its
syntax tree, without comments, docstrings and layout, so that a release which only moves lines is
the same code, and one that changes behaviour is not, whatever its number.
"""

from __future__ import annotations

import ast
import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from play_launch.graph_daemon.patch import PatchError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path


@dataclass(frozen=True, slots=True)
class Known:
    """What the overlay fits.

    Attributes:
        series: Name of a ROS 2 distribution for each series of releases, (major, minor).
        definitions: For each file of ros2cli, relative to its package, the digests under which
            each definition is known.
    """

    series: Mapping[tuple[int, int], str]
    definitions: Mapping[str, Mapping[str, frozenset[str]]]

    @property
    def files(self) -> tuple[str, ...]:
        """The files that hold the definitions."""
        return tuple(self.definitions)

    def check(self, folder: Path, version: str) -> str:
        """Return the name of the distribution whose ros2cli is in ``folder``.

        Raises ``PatchError`` for a release or for code that the overlay was not made for.
        """
        name = self._distribution(version)
        differing = [
            f"{file}: {definition}"
            for file, definitions in self.definitions.items()
            for definition, digests in definitions.items()
            if _digest_in(folder / file, definition) not in digests
        ]
        if differing:
            raise PatchError(
                f"ros2cli {version} in {folder} is not the code that the changes were made for; "
                f"it differs in {', '.join(differing)}. Use 'play-launch daemon start' instead, "
                "which needs no ros2cli"
            )
        return name

    def _distribution(self, version: str) -> str:
        words = version.split(".")
        if len(words) >= 2 and words[0].isdigit() and words[1].isdigit():
            name = self.series.get((int(words[0]), int(words[1])))
            if name is not None:
                return name
        fit = ", ".join(f"{a}.{b} ({name})" for (a, b), name in self.series.items())
        raise PatchError(
            f"ros2cli {version} is not known here; the changes fit {fit}. Use 'play-launch daemon "
            "start' instead, which needs no ros2cli"
        )


def definition_digest(source: str, name: str) -> str:
    """Give the digest of the function or class ``name`` at the top of ``source``; "" if missing."""
    for node in ast.parse(source).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name == name:
            text = "\n".join(_described(node))
            return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:16]
    return ""


def _digest_in(path: Path, name: str) -> str:
    try:
        return definition_digest(path.read_text(encoding="utf-8"), name)
    except (OSError, SyntaxError, ValueError):
        return ""


def _described(node: ast.AST) -> Iterator[str]:
    """Write a tree out, a line for each node, the same in every version of Python.

    Fields that are empty are left out: newer versions have more of them.
    """
    yield type(node).__name__
    for field, value in ast.iter_fields(node):
        for item in value if isinstance(value, list) else [value]:
            if isinstance(item, ast.AST):
                if not isinstance(item, ast.Load) and not _is_docstring(item):
                    yield f"{field}("
                    yield from _described(item)
                    yield ")"
            elif item is not None:
                yield f"{field}={item!r}"


def _is_docstring(node: ast.AST) -> bool:
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )


KNOWN: Final = Known(
    series={(0, 18): "humble", (0, 32): "jazzy"},
    # Seen in 0.18.7 to 0.18.11 and in 0.32.0 to 0.32.2; where there are two, the first is Humble's.
    definitions={
        "daemon/__init__.py": {
            "RequestHandler": frozenset({"746157d92d828e82"}),
            "make_xmlrpc_server": frozenset({"23f34164facf474c", "e5e47176631fd720"}),
            "serve": frozenset({"a325eaf500e27475", "acd0dcde2d2bcaa7"}),
        },
        "helpers.py": {
            "before_invocation": frozenset({"eb9cb4a6efced3d0"}),
            "pretty_print_call": frozenset({"13cd707061887a74"}),
        },
        "node/network_aware.py": {
            "NetworkAwareNode": frozenset({"bd42341d5891a218"}),
            "get_interfaces_ip_addresses": frozenset({"9037591817a3be9d", "0104234a84800c6f"}),
        },
        "xmlrpc/local_server.py": {
            "LocalXMLRPCServer": frozenset({"c0e6efcb92e01cce"}),
            "get_local_ipaddrs": frozenset({"b4bd6d93957b526c", "e6a9d4104d9225d0"}),
        },
    },
)
"""The releases that were read and run."""
