"""``play-launch node | topic | service``: the ROS graph, from the graph daemon.

They import neither pydantic nor rclpy, which takes longer than the answer. Options and output are
those of ``ros2 node list`` and the like.
"""

from __future__ import annotations

import sys
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Final, NamedTuple

import typer

from play_launch.cli import options
from play_launch.cli.output import note, printable, redirect_to_devnull, report, warn
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
from play_launch.supervisor.exit_code import ExitCode

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

All = Annotated[bool, typer.Option("--all", "-a", help="Include hidden ones.")]
ShowTypes = Annotated[bool, typer.Option("--show-types", "-t", help="Print types as well.")]
CallTimeout = Annotated[
    float,
    typer.Option(
        "--call-timeout",
        parser=options.duration,
        metavar="TIME",
        help="Limit for an answer of the daemon.",
        show_default=f"{DEFAULT_TIMEOUT:g}s",
    ),
]
NoStart = Annotated[bool, typer.Option("--no-start", help="Do not start a daemon if none runs.")]


@node.command("list")
def node_list(
    count: Annotated[
        bool, typer.Option("--count-nodes", "-c", help="Print their number only.")
    ] = False,
    with_hidden: All = False,
    call_timeout: CallTimeout = DEFAULT_TIMEOUT,
    no_start: NoStart = False,
    as_json: options.Json = False,
) -> int:
    """List the nodes."""

    def show(client: GraphClient) -> int:
        nodes = _visible(client.nodes(), with_hidden=with_hidden)
        names = [each.full_name for each in nodes]
        if count:
            _say(str(len(names)))
        elif as_json:
            _print_json(
                [
                    {"name": n.name, "namespace": n.namespace, "full_name": n.full_name}
                    for n in nodes
                ]
            )
        else:
            _print_lines(names)
        twice = sorted({name for name, after in pairwise(names) if name == after})
        if twice:
            names_twice = _one_line(", ".join(twice))
            warn(f"several nodes have the same name, which ROS does not allow: {names_twice}")
        return ExitCode.OK

    return _asked(show, call_timeout, no_start=no_start)


@node.command("info")
def node_info(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NODE", help="Full name, for example /sensing/camera.", show_default=False
        ),
    ],
    with_hidden: Annotated[
        bool, typer.Option("--include-hidden", help="Include hidden names.")
    ] = False,
    call_timeout: CallTimeout = DEFAULT_TIMEOUT,
    no_start: NoStart = False,
    as_json: options.Json = False,
) -> int:
    """Show publishers, subscriptions, services and actions of a node."""
    wanted = name if name.startswith("/") else f"/{name}"
    return _asked(
        lambda client: _info(client, wanted, with_hidden=with_hidden, as_json=as_json),
        call_timeout,
        no_start=no_start,
    )


@topic.command("list")
def topic_list(  # noqa: PLR0917 - options, by name
    count: Annotated[
        bool, typer.Option("--count-topics", "-c", help="Print their number only.")
    ] = False,
    show_types: ShowTypes = False,
    with_hidden: Annotated[
        bool, typer.Option("--all", "-a", "--include-hidden-topics", help="Include hidden ones.")
    ] = False,
    call_timeout: CallTimeout = DEFAULT_TIMEOUT,
    no_start: NoStart = False,
    as_json: options.Json = False,
) -> int:
    """List the topics."""
    shown = _ListOptions(count, show_types, with_hidden, as_json)
    return _asked(
        lambda client: _list(client.names_and_types("get_topic_names_and_types"), shown),
        call_timeout,
        no_start=no_start,
    )


@service.command("list")
def service_list(  # noqa: PLR0917 - options, by name
    count: Annotated[
        bool, typer.Option("--count-services", "-c", help="Print their number only.")
    ] = False,
    show_types: ShowTypes = False,
    with_hidden: Annotated[
        bool, typer.Option("--all", "-a", "--include-hidden-services", help="Include hidden ones.")
    ] = False,
    call_timeout: CallTimeout = DEFAULT_TIMEOUT,
    no_start: NoStart = False,
    as_json: options.Json = False,
) -> int:
    """List the services."""
    shown = _ListOptions(count, show_types, with_hidden, as_json)
    return _asked(
        lambda client: _list(client.names_and_types("get_service_names_and_types"), shown),
        call_timeout,
        no_start=no_start,
    )


@topic.callback()
@service.callback()
def _group() -> None:
    """Keep the name of a single subcommand on the command line."""


class _ListOptions(NamedTuple):
    only_count: bool
    types: bool
    with_hidden: bool
    as_json: bool


def _asked(
    show: Callable[[GraphClient], int],
    call_timeout: float,
    *,
    no_start: bool,
) -> int:
    """Query the daemon, which is started if none runs, and print; return the exit code."""
    try:
        address = daemon_address()
        client = GraphClient(address, call_timeout)
        try:
            status = show(client)
        except NoDaemonError as error:
            if no_start:
                report(f"{error}; start one with 'play-launch daemon start'")
                return ExitCode.NODE_FAILED
            _start(address)
            status = show(client)
        sys.stdout.flush()
    except BrokenPipeError:
        # The reader has enough (`| head`).
        redirect_to_devnull(sys.stdout)
        return ExitCode.OK
    except DomainError as error:
        report(str(error))
        return ExitCode.USAGE
    return status


def _start(address: DaemonAddress) -> None:
    """Start our daemon; returns when it knows the graph."""
    # Takes longer to import than all the rest, and is needed once.
    from play_launch.graph_daemon.start_stop import start_daemon  # noqa: PLC0415

    note(f"starting the graph daemon of ROS domain {address.domain}")
    try:
        messages = start_daemon(address, notify=warn).messages
    except OSError as error:
        raise DaemonError(str(error)) from None
    for message in messages:
        warn(message)


def _list(found: list[Named], shown_as: _ListOptions) -> int:
    shown = [entry for entry in found if shown_as.with_hidden or not _is_hidden(entry.name)]
    if shown_as.only_count:
        _say(str(len(shown)))
    elif shown_as.as_json:
        _print_json([_plain(entry) for entry in shown])
    elif shown_as.types:
        _print_lines(f"{entry.name} [{', '.join(entry.types)}]" for entry in shown)
    else:
        _print_lines(entry.name for entry in shown)
    return ExitCode.OK


def _info(client: GraphClient, wanted: str, *, with_hidden: bool, as_json: bool) -> int:
    same = [each for each in client.nodes() if each.full_name == wanted]
    if not same:
        report(f"there is no node {wanted}")
        return ExitCode.NODE_FAILED
    if len(same) > 1:
        warn(f"{len(same)} nodes have the name {wanted}; this is one of them")
    found_node = same[0]
    sections: dict[str, list[Named]] = {}
    try:
        for _, key, method in _SECTIONS:
            found = client.names_and_types(method, found_node.name, found_node.namespace)
            sections[key] = [e for e in found if with_hidden or not _is_hidden(e.name)]
    except RemoteError as error:
        if found_node in client.nodes():
            raise
        report(f"the node {wanted} has exited meanwhile ({error.text})")
        return ExitCode.NODE_FAILED
    if as_json:
        facts = {key: [_plain(entry) for entry in found] for key, found in sections.items()}
        _print_json(
            {
                "name": found_node.name,
                "namespace": found_node.namespace,
                "full_name": wanted,
                **facts,
            }
        )
        return ExitCode.OK
    _say(wanted)
    for title, key, _ in _SECTIONS:
        _say(f"  {title}:")
        _print_lines(f"    {entry.name}: {', '.join(entry.types)}" for entry in sections[key])
    return ExitCode.OK


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


def _one_line(text: str) -> str:
    """Make a line of what holds names: those come from any program in the network."""
    return printable(text.replace("\n", " "))
