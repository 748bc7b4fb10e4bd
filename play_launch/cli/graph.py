"""``play-launch graph check``: what does not connect in the ROS graph, and what has to change."""

from __future__ import annotations

import json
import time
from collections import Counter
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Annotated, Any, Final, NamedTuple

import typer

from play_launch import ExitCode
from play_launch.cli import options
from play_launch.cli.node import CallTimeout, NoStart, query
from play_launch.cli.output import note, printable, say, table
from play_launch.config.text import counted, listed
from play_launch.graph_daemon.contract import STATUS_METHOD
from play_launch.graph_daemon.graph_client import DEFAULT_TIMEOUT
from play_launch.supervisor.endpoints import connections, similar_topic

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from play_launch.graph_daemon.graph_client import GraphClient, NodeName
    from play_launch.supervisor.endpoints import Endpoint

_MANY: Final = 8
"""Nodes that are listed."""
_MOST_GUESSES: Final = 50
"""Topics without publisher for which similar ones are searched."""
_QUIET: Final = 1.0
"""Seconds without a change after which the graph counts as complete."""
_PAUSE: Final = 0.1
_ACTION: Final = "/_action/"

graph = typer.Typer(help="Check the connections.", no_args_is_help=True, **options.PLAIN)
graph.callback()(lambda: None)  # keeps the name of the single subcommand


class GraphProblem(NamedTuple):
    """One topic, service or node at which something does not connect."""

    kind: str
    """As of the findings of `explain`; ``unsubscribed`` is none."""
    name: str
    text: str
    sides: tuple[tuple[str, ...], ...]
    """Nodes that are concerned; with a mismatch the publishers, then the subscribers."""


@graph.command("check")
def graph_check(  # noqa: PLR0917 - options, by name
    ignore: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATTERN",
            help="Leave out what has this name, or concerns nodes of such names only: "
            "'/debug/*'. Repeatable.",
        ),
    ] = None,
    with_all: Annotated[
        bool, typer.Option("--all", "-a", help="Print topics that nothing subscribes to as well.")
    ] = False,
    wait: Annotated[
        float,
        typer.Option(
            "--wait",
            parser=options.duration_or_zero,
            metavar="TIME",
            help="Wait until nothing has changed for a second, at most this long. Default: 10s.",
            show_default=False,
        ),
    ] = 10.0,
    call_timeout: CallTimeout = DEFAULT_TIMEOUT,
    no_start: NoStart = False,
    as_json: options.Json = False,
) -> int:
    """Find what does not connect in the ROS graph.

    Incompatible QoS with the policy and the side that has to change, topics with several types,
    subscriptions without a publisher with the topic that may be meant, services and actions without
    a server, and nodes of one name. Exits with 1 if there is any of these.
    """
    problems: list[GraphProblem] = []
    seen: dict[str, Any] = {}

    def check(client: GraphClient) -> None:
        seen["quiet"] = _wait_until_quiet(client, wait)
        nodes, endpoints = client.nodes(), client.endpoints()
        found = [*of_topics(endpoints), *of_services(client, nodes), *of_names(nodes)]
        problems.extend(each for each in found if not _is_ignored(each, ignore or ()))
        seen["topics"] = len({each.topic for each in endpoints})
        seen["nodes"] = len({each.full_name for each in nodes if not each.is_hidden})

    query(check, call_timeout, no_start=no_start)
    failures = [each for each in problems if each.kind != "unsubscribed"]
    if as_json:
        say(json.dumps({**seen, "problems": [each._asdict() for each in problems]}))
    else:
        _print(problems if with_all else failures)
        unused = len(problems) - len(failures)
        counts = f"{counted(seen['topics'], 'topic')}, {counted(seen['nodes'], 'node')}"
        more = f", {counted(unused, 'topic')} without subscription" if unused else ""
        hint = " (--all lists them)" if unused and not with_all else ""
        say(f"{counts}: {counted(len(failures), 'problem')}{more}{hint}")
        if not seen["quiet"]:
            note("the graph was still changing; --wait TIME waits longer")
    return ExitCode.NODE_FAILED if failures else ExitCode.OK


def of_topics(endpoints: Sequence[Endpoint]) -> Iterator[GraphProblem]:
    """Compare publishers and subscriptions."""
    guesses = 0
    for each in sorted(connections(endpoints)):
        sides = each.publishers, each.subscribers
        for mismatch in each.mismatches:
            is_type = mismatch.policy == "type"
            kind = "incompatible_type" if is_type else "incompatible_qos"
            between = mismatch.publishers, mismatch.subscribers
            yield GraphProblem(kind, each.topic, str(mismatch), between)
        if each.subscribers and not each.has_publisher:
            meant = ""
            if guesses < _MOST_GUESSES:
                guesses += 1
                meant = _meant(each.topic, endpoints)
            kind = "misnamed_topic" if meant else "unpublished"
            text = f"no publisher; {listed(each.subscribers, _MANY)} subscribes to it{meant}"
            yield GraphProblem(kind, each.topic, text, sides[1:])
        if each.publishers and not each.subscribers:
            text = f"no subscription; {listed(each.publishers, _MANY)} publishes it"
            yield GraphProblem("unsubscribed", each.topic, text, sides[:1])


def _meant(topic: str, endpoints: Sequence[Endpoint]) -> str:
    for unused in (True, False):
        if meant := similar_topic(topic, endpoints, unused=unused):
            publishers = {each.node for each in endpoints if each.topic == meant}
            return f"; did you mean {meant} of {listed(sorted(publishers), _MANY)}?"
    return ""


def of_services(client: GraphClient, nodes: Iterable[NodeName]) -> Iterator[GraphProblem]:
    """Find services and actions that have clients and no server."""
    unserved = {name for name, _ in client.unserved_services()}
    if not unserved:
        return
    clients: dict[str, set[str]] = {}
    for node in nodes:
        if node.is_hidden:
            continue
        found = client.names_and_types("get_client_names_and_types_by_node", *node)
        for service in unserved.intersection(name for name, _ in found):
            # An action is three services.
            clients.setdefault(service.partition(_ACTION)[0], set()).add(node.full_name)
    actions = {name.partition(_ACTION)[0] for name in unserved if _ACTION in name}
    for name, every in sorted(clients.items()):
        kind = "action" if name in actions else "service"
        text = f"no server; {listed(sorted(every), _MANY)} has a client of this {kind}"
        yield GraphProblem("unserved", name, text, (tuple(sorted(every)),))


def of_names(nodes: Iterable[NodeName]) -> Iterator[GraphProblem]:
    """Find nodes that have the same name."""
    for name, count in sorted(Counter(each.full_name for each in nodes).items()):
        if count > 1:
            yield GraphProblem("same_name", name, f"{count} nodes have this name", ((name,),))


def _is_ignored(problem: GraphProblem, patterns: Sequence[str]) -> bool:
    def matches(name: str) -> bool:
        return any(fnmatchcase(name, pattern) for pattern in patterns)

    return matches(problem.name) or any(all(map(matches, side)) for side in problem.sides)


def _wait_until_quiet(client: GraphClient, limit: float) -> bool:
    """Wait until nothing changes any more; False if it still does."""
    deadline = time.monotonic() + limit
    while True:
        status = json.loads(client.call(STATUS_METHOD))
        if status["settled"] and status["unchanged_for"] >= _QUIET:
            return True
        if time.monotonic() + _PAUSE > deadline:
            return False
        time.sleep(_PAUSE)


def _print(problems: Sequence[GraphProblem]) -> None:
    if problems:
        rows = [(each.kind.replace("_", " "), each.name, each.text) for each in problems]
        lines = table(("PROBLEM", "NAME", "WHAT"), rows, words=2)
        say("\n".join(printable(line.replace("\n", " ")) for line in lines))
