"""The state of an evaluation: launch configurations, environment, and where it stands."""

from __future__ import annotations

import math
import os
import re
import time
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct, field

from play_launch.config.substitutions import share_folder
from play_launch.launch_files.losses import Losses
from play_launch.launch_files.markup.template import Call, parse
from play_launch.launch_files.markup.trouble import Exceeded, Trouble
from play_launch.launch_files.records import Description, Origin, Place, StartCondition

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from play_launch.launch_files.markup.entity import Entity
    from play_launch.launch_files.markup.template import Template


LONGEST: Final = 16 * 2**20
"""Characters of a text with its substitutions carried out."""
MOST_ACTIONS: Final = 200_000
"""How many actions are carried out; the largest systems have some thousands."""


class Deferred(Struct):
    """Actions that a timer holds back: they are evaluated after everything else."""

    entities: list[Entity]
    chain: tuple[Place, ...]
    file: str
    directory: str
    start: tuple[StartCondition, ...]


class Context(Struct):
    """One evaluation.

    `configurations` hold launch configurations, which are texts, and, as in launch_ros, the global
    parameters and remappings as lists that a group copies by reference only. `file` and `directory`
    are those of `$(filename)` and `$(dirname)`; `chain` are the includes that led here, the nearest
    first. `start` are the conditions of what is evaluated now.
    """

    environment: dict[str, str]
    initial_environment: Mapping[str, str]
    file: str
    directory: str
    configurations: dict[str, Any] = field(default_factory=dict)
    chain: tuple[Place, ...] = ()
    start: tuple[StartCondition, ...] = ()
    description: Description = field(default_factory=Description)
    losses: Losses = field(default_factory=Losses)
    deferred: list[Deferred] = field(default_factory=list)
    find_share: Callable[[str], Path | None] = share_folder
    only_arguments: bool = False
    """Whether arguments are looked for only, so that what fails is passed over."""
    deadline: float = math.inf
    """When programs have to be done, by the monotonic clock."""
    limit: float = math.inf
    """Seconds that the evaluation may take; `deadline` is their end."""
    given: frozenset[str] = frozenset()
    """Names of the arguments of the command line."""
    _scopes: list[tuple[dict[str, Any], dict[str, str]]] = field(default_factory=list)
    _units: int = 0
    _actions: int = 0

    def count_action(self) -> None:
        """Count an action that is to be carried out.

        Raises:
            Exceeded: When it is one too many, or comes too late.
        """
        self._actions += 1
        if self._actions > MOST_ACTIONS:
            raise Exceeded(
                f"more than {MOST_ACTIONS} actions; do files include one another many times?"
            )
        if self.limit > 0 and time.monotonic() > self.deadline:
            raise Exceeded(f"it is not evaluated after {self.limit:g} s")

    def origin(self, entity: Entity) -> Origin:
        """Return where an entity stands, with the includes that led there."""
        return Origin(entity.place, self.chain)

    def new_id(self) -> str:
        """Return an id for a record."""
        self._units += 1
        return str(self._units)

    def push(self) -> None:
        """Begin a scope."""
        self._scopes.append((dict(self.configurations), dict(self.environment)))

    def pop(self) -> None:
        """End a scope."""
        self.configurations, self.environment = self._scopes.pop()

    def text(self, value: str) -> str:
        """Return a text with its substitutions carried out."""
        return self.carried_out(parse(value))

    def carried_out(self, template: Template) -> str:
        """Return a parsed text with its substitutions carried out."""
        from play_launch.launch_files.markup.substitutions import carry_out  # noqa: PLC0415 - a cycle

        text = "".join(
            carry_out(part, self) if isinstance(part, Call) else part for part in template
        )
        if len(text) > LONGEST:
            raise Trouble(f"a text of {len(text)} characters; at most {LONGEST}")
        return text

    @property
    def unset(self) -> list[str]:
        """Variables that were there at the beginning, and are not any more."""
        return sorted(self.initial_environment.keys() - self.environment.keys())

    def changed(self, more: Mapping[str, str]) -> list[tuple[str, str]]:
        """Return the variables that differ from those at the beginning; `more` come on top."""
        wanted = {**self.environment, **more}
        return sorted(
            (name, value)
            for name, value in wanted.items()
            if self.initial_environment.get(name) != value
        )


def beginning(
    arguments: Mapping[str, str], file: str, environ: Mapping[str, str] | None = None
) -> Context:
    """Return the context in which a launch file begins."""
    environment = dict(os.environ if environ is None else environ)
    return Context(
        environment=environment,
        initial_environment=dict(environment),
        file=file,
        directory=os.path.dirname(file),  # noqa: PTH120 - as launch does it
        configurations=dict(arguments),
        given=frozenset(arguments),
    )


_VALID_NAMESPACE: Final = re.compile(r"/|(?:/[A-Za-z_][A-Za-z0-9_]*)+", re.ASCII)


def joined_namespace(base: str | None, own: str | None) -> str | None:
    """Return the absolute namespace; None if neither is given.

    Raises:
        Trouble: When it is no namespace.
    """
    if own is None:
        namespace = base
    elif not base or own.startswith("/"):
        namespace = own
    else:
        namespace = f"{'' if base == '/' else base}/{own}"
    if namespace is None:
        return None
    if namespace != "/":
        namespace = namespace.rstrip("/")
    if not namespace.startswith("/"):
        namespace = f"/{namespace}"
    if not _VALID_NAMESPACE.fullmatch(namespace):
        raise Trouble(f"{namespace!r} is no namespace")
    return namespace
