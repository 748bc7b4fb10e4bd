"""``play-launch param``: parameters of running nodes, through their own services."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from play_launch import ExitCode
from play_launch.cli import options
from play_launch.cli.connection import connected
from play_launch.cli.output import report, say, warn
from play_launch.control.protocol import Code, OperationError

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.control.client import ControlClient
    from play_launch.ros.node_services import ParameterClient

_TIMEOUT: Final = 5.0

param = typer.Typer(
    help="Get, set and dump parameters of running nodes.", no_args_is_help=True, **options.PLAIN
)

Node = Annotated[
    str, options.argument("NODE", "Full name, or its last part if that is unambiguous.", "units")
]
Timeout = Annotated[
    float, options.time("Limit for each request to a node.", "--timeout", default="5s")
]


@param.command("get")
def get_(
    node: Node,
    parameters: Annotated[list[str], options.argument("PARAMETER...", "", "parameters")],
    timeout: Timeout = _TIMEOUT,
    session: options.Session = None,
    as_json: options.Json = False,
) -> None:
    """Print the values of parameters of a node."""
    with connected(session) as client:
        nodes = _nodes(client, [node], is_one=True)
        values = _asked(client, timeout, lambda ros: ros.get(nodes[0], parameters))
    _print_values(values, as_json=as_json)


@param.command("set")
def set_(  # noqa: PLR0917 - options, by name
    node: Node,
    parameter: Annotated[str, options.argument("PARAMETER", "", "parameters")],
    value: Annotated[
        str, options.argument("VALUE", "As YAML, of the type that the parameter has.")
    ],
    timeout: Timeout = _TIMEOUT,
    session: options.Session = None,
    as_json: options.Json = False,
) -> None:
    """Set a parameter of a node."""

    def change(ros: ParameterClient) -> dict[str, Any]:
        ros.set(nodes[0], parameter, value)
        return ros.get(nodes[0], [parameter]) if as_json else {}

    with connected(session) as client:
        nodes = _nodes(client, [node], is_one=True)
        values = _asked(client, timeout, change)
    if as_json:
        _print_values(values, as_json=True)


@param.command()
def dump(
    nodes: options.Names = None,
    timeout: Timeout = _TIMEOUT,
    session: options.Session = None,
    as_json: options.Json = False,
) -> int:
    """Print all parameters of nodes as a parameter file."""
    from play_launch.ros.node_services import NodeServiceError  # noqa: PLC0415 - slow

    found: dict[str, Any] = {}
    missing: list[str] = []

    def read(ros: ParameterClient) -> None:
        for node in _chosen:
            try:
                found[node] = ros.dump(node)
            except NodeServiceError as error:
                missing.append(str(error))

    with connected(session) as client:
        _chosen = _nodes(client, nodes or [])
        _asked(client, timeout, read)
    if as_json:
        say(json.dumps(found))
    elif found:
        import yaml  # noqa: PLC0415 - not for the others

        values = {node: {"ros__parameters": each} for node, each in found.items()}
        say(yaml.safe_dump(values, sort_keys=True, default_flow_style=None).removesuffix("\n"))
    for each in missing:
        (report if nodes else warn)(each)
    return ExitCode.NODE_FAILED if missing and (nodes or not found) else ExitCode.OK


def _nodes(client: ControlClient, wanted: list[str], *, is_one: bool = False) -> list[str]:
    rows = client.ask("ps", {"names": wanted})
    is_node = {"component": "loaded", "process": "running"}
    nodes = [row["name"] for row in rows if is_node.get(row["kind"]) == row["state"]]
    if not nodes:
        found = ", ".join(f"{row['name']} is a {row['kind']}, {row['state']}" for row in rows)
        listed = f": {found}" if wanted else ""
        raise OperationError(
            Code.REFUSED, f"only loaded components and running processes have parameters{listed}"
        )
    if is_one and len(nodes) > 1:
        raise OperationError(Code.AMBIGUOUS_NAME, f"{wanted[0]} are {len(nodes)} nodes; name one")
    return nodes


def _asked(client: ControlClient, timeout: float, request: Callable[[ParameterClient], Any]) -> Any:
    """Call services of nodes in the session's domain; raises OperationError."""
    from play_launch.cli.connection import enter_environment_of  # noqa: PLC0415 - slow

    enter_environment_of(client)
    from play_launch.ros.node_services import NodeServiceError, ParameterClient  # noqa: PLC0415 - slow

    with ParameterClient(timeout) as ros:
        try:
            return request(ros)
        except (NodeServiceError, ValueError) as error:
            raise OperationError(Code.FAILED, str(error)) from None


def _print_values(values: dict[str, Any], *, as_json: bool) -> None:
    if as_json:
        say(json.dumps(values))
        return
    for name, value in values.items():
        text = value if isinstance(value, str) else json.dumps(value)
        say(f"{name}: {text}" if len(values) > 1 else text)
