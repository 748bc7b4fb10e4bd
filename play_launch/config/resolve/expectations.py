"""What is expected of topics, at the top level and at nodes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from play_launch.config.expectations import Expectation
from play_launch.config.section import entries_of, validate_mapping
from play_launch.config.sections import ExpectationSection
from play_launch.config.values import check_topic, join_full_name

if TYPE_CHECKING:
    from collections.abc import Iterable

    from play_launch.config.problems import Location
    from play_launch.config.resolve.machines import Placement
    from play_launch.config.tree import Cursor

_EXPECTABLE: Final = "give " + ", ".join(key for key in ExpectationSection.keys if key != "machine")


class ExpectedTopics:
    """Collects them, a topic once.

    Attributes:
        found: By the full names of the topics.
    """

    def __init__(self, placement: Placement) -> None:
        self.found: dict[str, Expectation] = {}
        self._placement = placement
        self._locations: dict[str, Location] = {}

    def add(
        self,
        at: Cursor | None,
        *,
        namespace: str = "/",
        node: str | None = None,
        remappings: Iterable[tuple[str, str]] = (),
        machine: str | None = None,
    ) -> None:
        """Take a section `expect`, with names as its node uses them; mistakes are reported.

        `node` is the full name of the node; None: it has none. `machine` is where it runs; None:
        at the top level.
        """
        for entry, value in entries_of(at, "topics to what is expected of them"):
            section = validate_mapping(ExpectationSection, value)
            try:
                topic = _expanded(check_topic(entry.key), namespace, node)
                for source, target in remappings:
                    private = source.startswith("~") and node is None
                    if not private and _expanded(source, namespace, node) == topic:
                        topic = _expanded(target, namespace, node)
                        break
            except ValueError as error:
                value.problem(str(error), entry.location)
                continue
            if section is None:
                continue
            given = section.given
            if not given.keys() - {"machine"}:
                value.problem(f"nothing is expected of it; {_EXPECTABLE}")
            if given.get("max_rate", math.inf) < given.get("min_rate", 0.0):
                value.at_key("max_rate").problem("is less than min_rate")
            if "type" in given and "/msg/" not in given["type"]:
                given["type"] = given["type"].replace("/", "/msg/", 1)
            if machine is None or section.machine is not None:
                given["machine"] = self._placement.place(value, section.machine)
            else:
                given["machine"] = machine
            first = self._locations.setdefault(topic, entry.location)
            if first is not entry.location:
                value.problem(f"{topic} is given twice, first at {first}", entry.location)
            self.found[topic] = Expectation(topic=topic, **given)


def _expanded(name: str, namespace: str, node: str | None) -> str:
    if name.startswith("/"):
        return name
    if not name.startswith("~"):
        return join_full_name(namespace, name)
    if node is None:
        raise ValueError("~ is the name of a node, which is not given here; write it out")
    return f"{node}{name[1:]}"
