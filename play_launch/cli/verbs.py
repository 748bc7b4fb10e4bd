"""All verbs; imported before it is known which one is meant."""

from __future__ import annotations

from typing import Final

from play_launch.cli.session_verbs import SESSION_VERBS

GRAPH_VERBS: Final = ("node", "topic", "service")

VERBS: Final = (
    "replay",
    "launch",
    "dump",
    "check",
    "init",
    "schema",
    "import",
    "systemd-unit",
    *SESSION_VERBS,
    "info",
    "inspect",
    "report",
    "explain",
    "crashes",
    "compare",
    "rerun",
    "recover",
    "export",
    "layout",
    "doctor",
    "completion",
    "version",
    *GRAPH_VERBS,
    "daemon",
)
"""In the order of the help."""
ABOUT_RECORDINGS: Final = frozenset(VERBS[VERBS.index("info") : VERBS.index("doctor")])
