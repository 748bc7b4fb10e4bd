"""What can stand at the cursor."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from play_launch.cli.completion import commands
from play_launch.cli.completion.commands import Command, Option, Value

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Sequence

    from play_launch.control.sessions import Seen

_OPTIONS: Final = "options"
_PATTERN: Final = frozenset("*?[")
_MORE_THAN_A_NAME: Final = _PATTERN | {":"}
_KINDS: Final = {
    commands.EVERYTHING: {"container", "process", "component"},
    commands.MEMBERS: {"container", "process"},
    commands.COMPONENTS: {"component"},
    commands.NODES: {"process", "component"},
}


class Candidate(NamedTuple):
    """A word, and what it means."""

    word: str
    about: str = ""


class Place(NamedTuple):
    """Where the cursor is: what fits there, what is typed of it, and what stands before."""

    value: Value
    typed: str
    before: str = ""
    """Of the same word: the name of an option and ``=``."""
    given: tuple[str, ...] = ()
    options: tuple[Option, ...] = ()
    session: str = ""


def place_of(words: Sequence[str], current: str, program: Command) -> Place | None:
    """Follow the words before the cursor; None where nothing can be known."""
    command = program
    given: list[str] = []
    session = ""
    pending: Option | None = None
    is_open = True
    for word in words:
        if pending is not None:
            if pending.value == Value(commands.SESSIONS):
                session = word
            pending = None
        elif is_open and word == "--":
            is_open = False
        elif is_open and word.startswith("-"):
            name, is_assigned, assigned = word.partition("=")
            option = _named(name, command)
            if is_assigned and name == "--session":
                session = assigned
            pending = option if option and option.value and not is_assigned else None
        elif command.verbs:
            if word not in command.verbs:
                return None
            command = command.verbs[word]()
        else:
            given.append(word)
    if pending is not None and pending.value is not None:
        return Place(pending.value, current, session=session)
    if is_open and current.startswith("-"):
        name, is_assigned, typed = current.partition("=")
        if not is_assigned:
            return Place(Value(_OPTIONS), current, options=command.options)
        option = _named(name, command)
        if option is None or option.value is None:
            return None
        return Place(option.value, typed, f"{name}=", session=session)
    if command.verbs:
        return Place(Value(commands.WORDS, tuple(command.verbs)), current)
    value = _positional(command, len(given))
    return None if value is None else Place(value, current, "", tuple(given), (), session)


def candidates(
    place: Place, look: Callable[[str, Sequence[str]], Iterable[Seen]]
) -> list[Candidate]:
    """Give what fits, and begins with what is typed.

    ``look`` asks the running sessions for an operation on names.
    """
    kind = place.value.kind
    if kind == _OPTIONS:
        return [
            Candidate(name, option.about)
            for option in place.options
            for name in option.names
            if name.startswith(place.typed) and (len(name) > 2 or place.typed == name)
        ]
    if kind == commands.WORDS:
        found = [Candidate(word) for word in place.value.words if word.startswith(place.typed)]
    elif kind == commands.SESSIONS:
        asked = look("ps", ())
        found = [each for each in _sessions(asked) if each.word.startswith(place.typed)]
    elif kind == commands.PARAMETERS:
        found = list(_parameters(place, look("parameters", place.given[:1])))
    else:
        is_pattern = kind != commands.NODES
        rows = [
            row for seen in look("ps", ()) if _is_meant(seen, place.session) for row in seen.rows
        ]
        wanted = [row for row in rows if row["kind"] in _KINDS[kind]]
        found = list(_names(place.typed, wanted, place.given, with_patterns=is_pattern))
    return [each._replace(word=place.before + each.word) for each in found]


def _named(name: str, command: Command) -> Option | None:
    return next((each for each in command.options if name in each.names), None)


def _positional(command: Command, number: int) -> Value | None:
    if number < len(command.positionals):
        return command.positionals[number]
    return command.positionals[-1] if command.is_endless and command.positionals else None


def _is_meant(seen: Seen, session: str) -> bool:
    folder = seen.folder.rstrip("/")
    known = {seen.name, str(seen.pid), folder, folder.rpartition("/")[2]}
    return not session or session.rstrip("/") in known


def _sessions(seen: Iterable[Seen]) -> Iterator[Candidate]:
    found = list(seen)
    names = Counter(each.name for each in found)
    for each in found:
        if names[each.name] == 1:
            yield Candidate(each.name, each.folder)
        yield Candidate(str(each.pid), f"{each.name}, {each.folder}")


def _parameters(place: Place, asked: Iterable[Seen]) -> Iterator[Candidate]:
    rows = [row for seen in asked if _is_meant(seen, place.session) for row in seen.rows]
    for name in dict.fromkeys(name for row in rows for name in row["parameters"]):
        if name.startswith(place.typed) and name not in place.given[1:]:
            yield Candidate(name)


def _names(
    typed: str, rows: Sequence[Any], given: Collection[str], *, with_patterns: bool
) -> Iterator[Candidate]:
    """Give names in full, with the container, or the last part alone: as it was begun."""
    offered = dict(_written(typed, rows))
    if with_patterns and typed[:1] in {"", "/"} and _MORE_THAN_A_NAME.isdisjoint(typed):
        below = Counter(name.rpartition("/")[0] for name in offered)
        offered |= {f"{space}/*": f"{n} names" for space, n in below.items() if space and n > 1}
    for name, about in offered.items():
        if name not in given and _fits(typed, name):
            yield Candidate(name, about)


def _written(typed: str, rows: Sequence[Any]) -> Iterator[tuple[str, str]]:
    tails = Counter(str(row["name"]).rpartition("/")[2] for row in rows)
    for row in rows:
        name, about = str(row["name"]), f"{row['kind']}, {row['state']}"
        if ":" in typed:
            if row["container"]:
                yield f"{row['container']}:{name}", about
        elif not typed or typed[0] == "/" or not _PATTERN.isdisjoint(typed):
            yield name, about
        elif tails[tail := name.rpartition("/")[2]] == 1:
            yield tail, about


def _fits(typed: str, name: str) -> bool:
    if _PATTERN.isdisjoint(typed):
        return name.startswith(typed)
    from fnmatch import fnmatchcase  # noqa: PLC0415 - rarely needed

    return name.startswith(typed) or fnmatchcase(name, f"{typed}*")
