"""``play-launch node | topic | service``: the ROS graph, from the daemon.

These verbs do without typer, pydantic and rclpy: their use is to be fast, and importing any of
those takes longer than the answer. Options and output are those of ``ros2 node list`` and its
like, so that people need not learn them.
"""

from __future__ import annotations

import argparse
import sys
from itertools import pairwise
from typing import TYPE_CHECKING, Final

from play_launch.cli.output import printable, redirect_to_devnull
from play_launch.graph_daemon.contract import DomainError, daemon_address
from play_launch.graph_daemon.graph_client import (
    DEFAULT_TIMEOUT,
    DaemonError,
    GraphClient,
    Named,
    NoDaemonError,
    NodeName,
    RemoteError,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from play_launch.graph_daemon.contract import DaemonAddress

GROUPS: Final = {
    "node": "Nodes of the running system: list, info.",
    "topic": "Topics of the running system: list.",
    "service": "Services of the running system: list.",
}
"""The first words that are ours, and what help says about them."""

OK: Final = 0
FAILED: Final = 1
USAGE: Final = 2

_HIDDEN: Final = "_"
_SECTIONS: Final = (
    ("Subscribers", "subscribers", "get_subscriber_names_and_types_by_node"),
    ("Publishers", "publishers", "get_publisher_names_and_types_by_node"),
    ("Service Servers", "service_servers", "get_service_names_and_types_by_node"),
    ("Service Clients", "service_clients", "get_client_names_and_types_by_node"),
    ("Action Servers", "action_servers", "get_action_server_names_and_types_by_node"),
    ("Action Clients", "action_clients", "get_action_client_names_and_types_by_node"),
)
"""Title, name in JSON and the daemon's method, in the order of ``ros2 node info``."""


def main(arguments: Sequence[str]) -> int:
    """Run one of the verbs; ``arguments`` start with its group. Returns the exit code."""
    options = parser_of_group(arguments[0]).parse_args(arguments[1:])
    try:
        status = _run(options)
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader has seen enough (`| head`).
        redirect_to_devnull(sys.stdout)
        status = OK
    return status


def _run(options: argparse.Namespace) -> int:
    verb: Callable[[GraphClient, argparse.Namespace], int] = options.verb
    try:
        address = daemon_address()
        client = GraphClient(address, options.call_timeout)
        try:
            return verb(client, options)
        except NoDaemonError as error:
            if options.no_start:
                _report(f"{error}; start one with 'play-launch daemon start'")
                return FAILED
        _start(address)
        options.no_start = True
        return verb(client, options)
    except DomainError as error:
        _report(str(error))
        return USAGE
    except DaemonError as error:
        _report(str(error))
    return FAILED


def _start(address: DaemonAddress) -> None:
    """Start our daemon; returns when it knows the graph."""
    # Takes longer to import than all the rest, and is needed once.
    from play_launch.graph_daemon.port import PortHeldError  # noqa: PLC0415
    from play_launch.graph_daemon.start_stop import StartError, start_daemon  # noqa: PLC0415

    sys.stderr.write(f"starting the graph daemon of ROS domain {address.domain}\n")
    try:
        messages = start_daemon(address, notify=_warn).messages
    except (PortHeldError, StartError, OSError) as error:
        raise DaemonError(str(error)) from None
    for message in messages:
        _warn(message)


def parser_of_group(group: str) -> argparse.ArgumentParser:
    """Build the parser of one group only; the others would take time for nothing."""
    parser = argparse.ArgumentParser(prog=f"play-launch {group}", description=GROUPS[group])
    # Named, or argparse would lay out a usage line first.
    verbs = parser.add_subparsers(required=True, metavar="VERB", prog=parser.prog)
    verb = _verb(verbs, "list", f"List the {group}s.", _LISTS[group])
    verb.add_argument(
        "-c", f"--count-{group}s", dest="count", action="store_true", help="print their number only"
    )
    if group == "node":
        verb.add_argument("-a", "--all", action="store_true", help="list hidden ones, too")
        info = _verb(verbs, "info", "Show what a node publishes, subscribes and serves.", node_info)
        info.add_argument("node", help="its full name, for example /sensing/camera")
        info.add_argument(
            "--include-hidden", dest="all", action="store_true", help="show hidden names, too"
        )
    else:
        verb.add_argument("-t", "--show-types", action="store_true", help="with their types")
        verb.add_argument(
            "-a",
            "--all",
            f"--include-hidden-{group}s",
            dest="all",
            action="store_true",
            help="list hidden ones, too",
        )
    return parser


def _verb(
    verbs: argparse._SubParsersAction[argparse.ArgumentParser],
    name: str,
    text: str,
    run: Callable[[GraphClient, argparse.Namespace], int],
) -> argparse.ArgumentParser:
    verb = verbs.add_parser(name, help=text, description=text)
    verb.set_defaults(verb=run)
    verb.add_argument("--json", action="store_true", help="for machines")
    verb.add_argument(
        "--call-timeout",
        type=_seconds,
        default=DEFAULT_TIMEOUT,
        metavar="S",
        help=f"seconds that the daemon has for an answer ({DEFAULT_TIMEOUT:g})",
    )
    verb.add_argument(
        "--no-start", action="store_true", help="do not start a daemon where none runs"
    )
    return verb


def list_nodes(client: GraphClient, options: argparse.Namespace) -> int:
    """``play-launch node list``."""
    nodes = _visible(client.nodes(), with_hidden=options.all)
    names = [node.full_name for node in nodes]
    if options.count:
        _say(str(len(names)))
    elif options.json:
        _print_json(
            [{"name": n.name, "namespace": n.namespace, "full_name": n.full_name} for n in nodes]
        )
    else:
        _print_lines(names)
    twice = sorted({name for name, after in pairwise(names) if name == after})
    if twice:
        _warn(f"several nodes bear the same name, which confuses ROS: {', '.join(twice)}")
    return OK


def list_topics(client: GraphClient, options: argparse.Namespace) -> int:
    """``play-launch topic list``."""
    return _list(client.names_and_types("get_topic_names_and_types"), options)


def list_services(client: GraphClient, options: argparse.Namespace) -> int:
    """``play-launch service list``."""
    return _list(client.names_and_types("get_service_names_and_types"), options)


_LISTS: Final = {"node": list_nodes, "topic": list_topics, "service": list_services}


def _list(found: list[Named], options: argparse.Namespace) -> int:
    shown = [entry for entry in found if options.all or not _is_hidden(entry.name)]
    if options.count:
        _say(str(len(shown)))
    elif options.json:
        _print_json([_plain(entry) for entry in shown])
    elif options.show_types:
        _print_lines(f"{entry.name} [{', '.join(entry.types)}]" for entry in shown)
    else:
        _print_lines(entry.name for entry in shown)
    return OK


def node_info(client: GraphClient, options: argparse.Namespace) -> int:
    """``play-launch node info``."""
    wanted = options.node if options.node.startswith("/") else f"/{options.node}"
    bearers = [node for node in client.nodes() if node.full_name == wanted]
    if not bearers:
        _report(f"there is no node {wanted}")
        return FAILED
    if len(bearers) > 1:
        _warn(f"{len(bearers)} nodes bear the name {wanted}; this is about one of them")
    node = bearers[0]
    sections: dict[str, list[Named]] = {}
    try:
        for _, key, method in _SECTIONS:
            found = client.names_and_types(method, node.name, node.namespace)
            sections[key] = [e for e in found if options.all or not _is_hidden(e.name)]
    except RemoteError as error:
        if node in client.nodes():
            raise
        _report(f"the node {wanted} has gone meanwhile ({error.text})")
        return FAILED
    if options.json:
        facts = {key: [_plain(entry) for entry in found] for key, found in sections.items()}
        _print_json({"name": node.name, "namespace": node.namespace, "full_name": wanted, **facts})
        return OK
    _say(wanted)
    for title, key, _ in _SECTIONS:
        _say(f"  {title}:")
        _print_lines(f"    {entry.name}: {', '.join(entry.types)}" for entry in sections[key])
    return OK


def _visible(nodes: Iterable[NodeName], *, with_hidden: bool) -> list[NodeName]:
    # A node is hidden by its own name, a topic or service by any part of it: so does ros2cli.
    return [
        node for node in nodes if with_hidden or (node.name and not node.name.startswith(_HIDDEN))
    ]


def _is_hidden(name: str) -> bool:
    return any(part.startswith(_HIDDEN) for part in name.split("/"))


def _plain(entry: Named) -> dict[str, object]:
    return {"name": entry.name, "types": entry.types}


def _print_json(value: object) -> None:
    import json  # noqa: PLC0415 - not needed for lines

    sys.stdout.write(f"{json.dumps(value)}\n")


def _say(line: str) -> None:
    _print_lines([line])


def _print_lines(lines: Iterable[str]) -> None:
    sys.stdout.writelines(f"{_one_line(line)}\n" for line in lines)


def _report(message: str) -> None:
    sys.stderr.write(f"error: {printable(message, colour=False)}\n")


def _warn(message: str) -> None:
    sys.stderr.write(f"warning: {_one_line(message)}\n")


def _one_line(text: str) -> str:
    """Make a line of what holds names: those come from any program in the network."""
    return printable(text.replace("\n", " "), colour=False)


def _seconds(text: str) -> float:
    value = float(text.removesuffix("s").strip())
    if not 0 < value < 1e6:
        raise ValueError
    return value
