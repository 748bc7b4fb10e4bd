"""What each verb takes, read from the parsers of argparse and typer."""

from __future__ import annotations

from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, NamedTuple, get_args, get_type_hints

from play_launch.cli.session_verbs import SESSION_VERBS
from play_launch.cli.verbs import GRAPH_VERBS, VERBS

if TYPE_CHECKING:
    from argparse import ArgumentParser
    from collections.abc import Callable, Mapping, Sequence


class Value(NamedTuple):
    """What can stand somewhere: words, or what the kind says."""

    kind: str
    words: tuple[str, ...] = ()


WORDS: Final = "words"
FILES: Final = "files"
FOLDERS: Final = "folders"
SESSIONS: Final = "sessions"
EVERYTHING: Final = "everything"
MEMBERS: Final = "members"
COMPONENTS: Final = "components"
NODES: Final = "nodes"
LAUNCH_FILE: Final = "launch file"
PARAMETERS: Final = "parameters"
"""Of the node that stands before."""

_ANYTHING: Final = Value(WORDS)
_SIGNALS: Final = Value(WORDS, ("HUP", "INT", "QUIT", "KILL", "USR1", "USR2", "TERM", "CONT"))
_NAMED_BY: Final = {
    **dict.fromkeys(("start", "stop", "restart"), MEMBERS),
    **dict.fromkeys(("load", "unload", "reload"), COMPONENTS),
}


class Option(NamedTuple):
    """An option: its names, what its value is (None: it has none), what help says."""

    names: tuple[str, ...]
    value: Value | None
    about: str


class Command(NamedTuple):
    """What a verb takes; the last of the positionals may be repeated."""

    options: tuple[Option, ...] = ()
    positionals: tuple[Value, ...] = ()
    is_endless: bool = False
    verbs: Mapping[str, Callable[[], Command]] = MappingProxyType({})


def program() -> Command:
    """Give what stands before the verb, and the verbs."""
    options = (
        Option(("--version",), None, "Print versions and exit."),
        Option(("-h", "--help"), None, "Show this message and exit."),
    )
    return Command(options, verbs={verb: partial(_verb, verb) for verb in VERBS})


def _verb(verb: str) -> Command:
    if verb in SESSION_VERBS:
        from play_launch.cli.operate import parser_of  # noqa: PLC0415 - slow

        return _from_argparse(parser_of(verb), verb)
    if verb in GRAPH_VERBS:
        from play_launch.cli.graph import parser_of_group  # noqa: PLC0415 - slow

        return _from_argparse(parser_of_group(verb), verb)
    from play_launch.cli.app import command_of  # noqa: PLC0415 - slow

    return _from_typer(command_of(verb))


def _from_argparse(parser: ArgumentParser, verb: str) -> Command:
    options: list[Option] = []
    positionals: list[Value] = []
    verbs: dict[str, Callable[[], Command]] = {}
    is_endless = False
    for action in parser._actions:  # noqa: SLF001 - there is no other way to ask
        takes_value = action.nargs != 0
        if action.option_strings:
            value = _value(action, verb) if takes_value else None
            about = action.help if action.help and "==" not in action.help else ""
            options.append(Option(tuple(action.option_strings), value, about))
        elif isinstance(action.choices, dict):
            for name, below in action.choices.items():
                verbs[name] = partial(_from_argparse, below, verb)
        else:
            positionals.append(_value(action, verb))
            is_endless = action.nargs in {"*", "+"}
    return Command(tuple(options), tuple(positionals), is_endless, verbs)


def _value(action: Any, verb: str) -> Value:
    if action.choices:
        return Value(WORDS, tuple(map(str, action.choices)))
    if words := _known_words(action.metavar):
        return Value(WORDS, words)
    if action.metavar == "FILE":
        return Value(FILES)
    match action.dest:
        case "names":
            return Value(_NAMED_BY.get(verb, EVERYTHING))
        case "node" | "nodes" if not action.option_strings:
            return Value(NODES)
        case "target":
            return Value(LAUNCH_FILE)
        case "parameter" | "parameters":
            return Value(PARAMETERS)
        case "session":
            return Value(SESSIONS)
        case "signal":
            return _SIGNALS
        case "config" | "svg":
            return Value(FILES)
    return _ANYTHING


def _known_words(metavar: str | None) -> tuple[str, ...]:
    """Give the words that can stand where help has this one; none where anything can."""
    match metavar:
        case "KIND":
            from play_launch.supervisor.event_object import (  # noqa: PLC0415 - only for this
                EVENT_TYPES,
            )

            return tuple(sorted(EVENT_TYPES.values()))
        case "LEVEL":
            from play_launch.cli.logs import LEVELS  # noqa: PLC0415 - as above

            return tuple(LEVELS)
        case "FORMAT":
            from play_launch.cli.export import FORMATS  # noqa: PLC0415 - as above

            return FORMATS
        case "TOOL":
            from play_launch.cli.layout import TOOLS  # noqa: PLC0415 - as above

            return TOOLS
    return ()


def _from_typer(command: Any) -> Command:
    from inspect import unwrap  # noqa: PLC0415 - typer needs it as well

    options = [Option(("-h", "--help"), None, "Show this message and exit.")]
    positionals: list[Value] = []
    is_endless = False
    # Which type a parameter has is said where it is declared; typer's own classes change.
    types = get_type_hints(unwrap(command.callback)) if command.callback else {}
    for parameter in command.params:
        known = _plain_types(types.get(parameter.name))
        words = _known_words(parameter.metavar)
        value = Value(WORDS, words) if words else _typed(known)
        if parameter.param_type_name == "option":
            names = (*parameter.opts, *parameter.secondary_opts)
            value = Value(FOLDERS) if parameter.metavar == "DIR" else value
            options.append(Option(names, None if bool in known else value, parameter.help or ""))
        else:
            is_target = (parameter.metavar or "").startswith("(PKG FILE")
            positionals.append(Value(LAUNCH_FILE) if is_target else value)
            is_endless = parameter.nargs == -1
    below = getattr(command, "commands", {})
    verbs = {name: partial(_from_typer, each) for name, each in below.items()}
    return Command(tuple(options), tuple(positionals), is_endless, verbs)


def _plain_types(annotation: Any) -> list[type]:
    """Give the classes in an annotation: of `list[Path] | None`, Path."""
    below = get_args(annotation)
    if not below:
        return [annotation] if isinstance(annotation, type) else []
    return [each for part in below for each in _plain_types(part)]


def _typed(known: Sequence[type]) -> Value:
    from enum import Enum  # noqa: PLC0415 - typer needs them as well
    from pathlib import Path  # noqa: PLC0415

    if Path in known:
        return Value(FILES)
    for each in known:
        if issubclass(each, Enum):
            return Value(WORDS, tuple(str(member.value) for member in each))
    return _ANYTHING
