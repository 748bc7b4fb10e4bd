"""All commands of ``play-launch``: name, module, and one line of help, in the order of the help.

Plain data: a module is imported when its command is called, and no other one.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Final, NamedTuple


class Needs(StrEnum):
    """What a command works on."""

    CONFIGURATION = "a configuration or a launch file"
    SESSION = "a running session"
    RECORDING = "a recording"
    NOTHING = "nothing"


class Command(NamedTuple):
    """A command: a function or a `Typer` in a module of `play_launch.cli`."""

    name: str
    group: str
    help: str
    needs: Needs
    shared_module: str = ""
    """The module, if it is not named like the command."""

    @property
    def function(self) -> str:
        """Name of the function, and of its module: dashes are underscores."""
        return "import_" if self.name == "import" else self.name.replace("-", "_")

    @property
    def module(self) -> str:
        """Module in `play_launch.cli`."""
        return self.shared_module or self.function


_CONFIGURATION, _SESSION = Needs.CONFIGURATION, Needs.SESSION
_RECORDING, _NOTHING = Needs.RECORDING, Needs.NOTHING
_START, _CONTROL = "Configure and start", "Control a running session"
_ANALYSE, _GRAPH, _SETUP = "Analyse recordings", "ROS graph", "Installation"

_ALL: Final = (
    Command("replay", _START, "Start a system and record it.", _CONFIGURATION),
    Command("launch", _START, "Start a ROS launch file and record it.", _CONFIGURATION),
    Command("dump", _START, "Convert a ROS launch file to a configuration.", _CONFIGURATION),
    Command("check", _START, "Check a configuration; start nothing.", _CONFIGURATION),
    Command("init", _START, "Write a configuration to begin with.", _NOTHING),
    Command("schema", _START, "Print the JSON Schema of configurations.", _NOTHING),
    Command("import", _START, "Convert a dump of play_launch (Rust).", _CONFIGURATION),
    Command("systemd-unit", _START, "Write a systemd unit.", _CONFIGURATION),
    Command("demo", _START, "Start the demo system: eight nodes, 10 s.", _NOTHING),
    Command("ps", _CONTROL, "List containers, nodes and processes.", _SESSION),
    Command("status", _CONTROL, "Show all about one container, node or process.", _SESSION),
    Command("top", _CONTROL, "Watch and operate a session on a screen.", _SESSION, "top.verb"),
    Command("events", _CONTROL, "Print events; with -f new ones, too.", _SESSION),
    Command("logs", _CONTROL, "Print output of nodes; with -f new lines, too.", _SESSION),
    Command("wait", _CONTROL, "Wait until a system is up.", _SESSION),
    Command("start", _CONTROL, "Start stopped containers or processes.", _SESSION, "operate"),
    Command("stop", _CONTROL, "Stop containers or processes.", _SESSION, "operate"),
    Command("restart", _CONTROL, "Restart containers or processes.", _SESSION, "operate"),
    Command("load", _CONTROL, "Load composable nodes that are not loaded.", _SESSION, "operate"),
    Command("unload", _CONTROL, "Unload composable nodes.", _SESSION, "operate"),
    Command(
        "reload", _CONTROL, "Unload composable nodes and load them again.", _SESSION, "operate"
    ),
    Command("signal", _CONTROL, "Send a signal to processes.", _SESSION, "operate"),
    Command("diff", _CONTROL, "Compare a session with a configuration.", _SESSION, "apply"),
    Command("apply", _CONTROL, "Change a session to match a configuration.", _SESSION),
    Command("param", _CONTROL, "Get, set and dump parameters of nodes.", _SESSION),
    Command("snapshot", _CONTROL, "Write the pre-crash buffer (record.before_crash).", _SESSION),
    Command("info", _ANALYSE, "Summarise a recording.", _RECORDING),
    Command("inspect", _ANALYSE, "Print the events of a recording.", _RECORDING),
    Command("report", _ANALYSE, "Write an HTML page about a recording.", _RECORDING),
    Command("explain", _ANALYSE, "Explain what went wrong in a session.", _RECORDING),
    Command("crashes", _ANALYSE, "Group the crashes of many sessions.", _RECORDING),
    Command("compare", _ANALYSE, "Compare two sessions.", _RECORDING),
    Command("rerun", _ANALYSE, "Repeat and compare the supervisor's decisions.", _RECORDING),
    Command("recover", _ANALYSE, "Repair a damaged or unfinished recording.", _RECORDING),
    Command("export", _ANALYSE, "Convert a recording to Perfetto, CSV or Parquet.", _RECORDING),
    Command("layout", _ANALYSE, "Print a layout for Foxglove or PlotJuggler.", _RECORDING),
    Command("node", _GRAPH, "List nodes; show one.", _NOTHING, "graph"),
    Command("topic", _GRAPH, "List topics.", _NOTHING, "graph"),
    Command("service", _GRAPH, "List services.", _NOTHING, "graph"),
    Command("daemon", _GRAPH, "Run the graph daemon in place of ros2cli's.", _NOTHING),
    Command("doctor", _SETUP, "Check this machine, with fixes.", _NOTHING),
    Command("completion", _SETUP, "Print the completion script of a shell.", _NOTHING),
    Command("version", _SETUP, "Print versions.", _NOTHING),
)
COMMANDS: Final = {each.name: each for each in _ALL}
