"""The verbs that operate a running session; imported before it is known which verb is meant."""

from __future__ import annotations

from typing import Final

SESSION_VERBS: Final = {
    "ps": ("ps", "List what runs: containers, nodes, processes."),
    "top": ("top.verb", "Show what runs on a screen, with keys to operate it."),
    "events": ("events", "Show what has happened, and with -f what happens."),
    "logs": ("logs", "Show what nodes print, and with -f go on."),
    "wait": ("wait", "Wait until a system is up."),
    "start": ("act", "Start containers or processes that do not run."),
    "stop": ("act", "Stop containers or processes, and leave the others alone."),
    "restart": ("act", "Replace containers or processes by new ones."),
    "load": ("act", "Load composable nodes that are not."),
    "unload": ("act", "Unload composable nodes."),
    "reload": ("act", "Unload composable nodes and load them again."),
    "signal": ("act", "Send a signal to processes."),
    "diff": ("change", "Show what differs between a configuration and what runs."),
    "apply": ("change", "Change a running system to what a configuration says, and only that."),
    "param": ("param", "Read and set parameters of running nodes."),
    "snapshot": (
        "snapshot",
        "Record the seconds that record.before_crash holds in memory.",
    ),
}
"""In the order of the help: the module in `play_launch.cli`, which has `add_arguments` and `run`,
and what the help says."""
