"""``play-launch node | topic | service``: the ROS graph, from the graph daemon.

They import neither msgspec nor rclpy, which takes longer than the answer. Options and output are
those of ``ros2 node list`` and the like.
"""

from __future__ import annotations

import json
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Final

import typer

from play_launch import ExitCode
from play_launch.cli import options
from play_launch.cli.output import fail, note, printable, say, warn
from play_launch.graph_daemon.contract import daemon_address
from play_launch.graph_daemon.graph_client import (
    DEFAULT_TIMEOUT,
    GraphClient,
    Named,
    NoDaemonError,
    RemoteError,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from play_launch.graph_daemon.contract import DaemonAddress

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


node = typer.Typer(help="List nodes; show one.", no_args_is_help=True, **options.PLAIN)
topic = typer.Typer(help="List topics.", no_args_is_help=True, **options.PLAIN)
service = typer.Typer(help="List services.", no_args_is_help=True, **options.PLAIN)

CallTimeout = Annotated[
    float,
    options.time(
        "Limit for an answer of the daemon.", "--call-timeout", default=f"{DEFAULT_TIMEOUT:g}s"
    ),
]
NoStart = Annotated[bool, typer.Option("--no-start", help="Do not start a daemon if none runs.")]


@node.command("list")
def node_list(
    count: Annotated[
        bool, typer.Option("--count-nodes", "-c", help="Print their number only.")
    ] = False,
    with_hidden: Annotated[bool, typer.Option("--all", "-a", help="Include hidden ones.")] = False,
    call_timeout: CallTimeout = DEFAULT_TIMEOUT,
    no_start: NoStart = False,
    as_json: options.Json = False,
) -> None:
    """List the nodes."""

    def show(client: GraphClient) -> None:
        # A node is hidden by its own name, a topic or service by any part of it: so does ros2cli.
        nodes = [each for each in client.nodes() if with_hidden or not each.is_hidden]
        names = [each.full_name for each in nodes]
        if as_json and not count:
            say(json.dumps([{**each._asdict(), "full_name": each.full_name} for each in nodes]))
        else:
            _print_lines([str(len(names))] if count else names)
        if twice := sorted({name for name, after in pairwise(names) if name == after}):
            names_twice = _one_line(", ".join(twice))
            warn(f"several nodes have the same name, which ROS does not allow: {names_twice}")

    query(show, call_timeout, no_start=no_start)


@node.command("info")
def node_info(
    name: Annotated[str, options.argument("NODE", "Full name, for example /sensing/camera.")],
    with_hidden: Annotated[
        bool, typer.Option("--include-hidden", help="Include hidden names.")
    ] = False,
    call_timeout: CallTimeout = DEFAULT_TIMEOUT,
    no_start: NoStart = False,
    as_json: options.Json = False,
) -> None:
    """Show publishers, subscriptions, services and actions of a node."""
    wanted = name if name.startswith("/") else f"/{name}"

    def show(client: GraphClient) -> None:
        same = [each for each in client.nodes() if each.full_name == wanted]
        if not same:
            fail(f"there is no node {wanted}", ExitCode.NODE_FAILED)
        if len(same) > 1:
            warn(f"{len(same)} nodes have the name {wanted}; this is one of them")
        sections: dict[str, list[Named]] = {}
        try:
            for _, key, method in _SECTIONS:
                found = client.names_and_types(method, same[0].name, same[0].namespace)
                sections[key] = _visible(found, with_hidden=with_hidden)
        except RemoteError as error:
            if same[0] in client.nodes():
                raise
            fail(f"the node {wanted} has exited meanwhile ({error.text})", ExitCode.NODE_FAILED)
        if as_json:
            values = {key: [each._asdict() for each in found] for key, found in sections.items()}
            say(json.dumps({**same[0]._asdict(), "full_name": wanted, **values}))
            return
        _print_lines([wanted])
        for title, key, _ in _SECTIONS:
            lines = [f"    {entry.name}: {', '.join(entry.types)}" for entry in sections[key]]
            _print_lines([f"  {title}:", *lines])

    query(show, call_timeout, no_start=no_start)


def _add_list(group: typer.Typer, noun: str) -> None:
    """Add ``list`` to ``topic`` or ``service``."""

    def show_list(
        *,
        count: bool = False,
        show_types: Annotated[
            bool, typer.Option("--show-types", "-t", help="Print types as well.")
        ] = False,
        with_hidden: bool = False,
        call_timeout: CallTimeout = DEFAULT_TIMEOUT,
        no_start: NoStart = False,
        as_json: options.Json = False,
    ) -> None:
        def show(client: GraphClient) -> None:
            found = client.names_and_types(f"get_{noun}_names_and_types")
            shown = _visible(found, with_hidden=with_hidden)
            if count:
                _print_lines([str(len(shown))])
            elif as_json:
                say(json.dumps([entry._asdict() for entry in shown]))
            elif show_types:
                _print_lines(f"{entry.name} [{', '.join(entry.types)}]" for entry in shown)
            else:
                _print_lines(entry.name for entry in shown)

        query(show, call_timeout, no_start=no_start)

    # Annotations that use local names cannot be evaluated.
    hidden = typer.Option("--all", "-a", f"--include-hidden-{noun}s", help="Include hidden ones.")
    only_count = typer.Option(f"--count-{noun}s", "-c", help="Print their number only.")
    show_list.__annotations__["with_hidden"] = Annotated[bool, hidden]
    show_list.__annotations__["count"] = Annotated[bool, only_count]
    group.command("list", help=f"List the {noun}s.")(show_list)
    group.callback()(lambda: None)  # keeps the name of a single subcommand on the command line


_add_list(topic, "topic")
_add_list(service, "service")


def query(show: Callable[[GraphClient], None], call_timeout: float, *, no_start: bool) -> None:
    """Query the daemon, which is started if none runs, and print."""
    address = daemon_address()
    client = GraphClient(address, call_timeout)
    try:
        show(client)
    except NoDaemonError as error:
        if no_start:
            fail(f"{error}; start one with 'play-launch daemon start'", ExitCode.NODE_FAILED)
        _start(address)
        show(client)


def _start(address: DaemonAddress) -> None:
    # Takes longer to import than all the rest, and is needed once.
    from play_launch.graph_daemon.start_stop import start_daemon  # noqa: PLC0415

    note(f"starting the graph daemon of ROS domain {address.domain}")
    for message in start_daemon(address, notify=warn).messages:
        warn(message)


def _visible(found: list[Named], *, with_hidden: bool) -> list[Named]:
    return [
        each
        for each in found
        if with_hidden or not any(part.startswith(_HIDDEN) for part in each.name.split("/"))
    ]


def _print_lines(lines: Iterable[str]) -> None:
    if text := "\n".join(map(_one_line, lines)):
        say(text)


def _one_line(text: str) -> str:
    """Make a line of what holds names: those come from any program in the network."""
    return printable(text.replace("\n", " "))
