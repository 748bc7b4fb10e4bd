"""``play-launch param``: parameters of running nodes, through their own services."""

from __future__ import annotations

import json
import sys
from argparse import SUPPRESS
from typing import TYPE_CHECKING, Any, Final

from play_launch.cli.operate import FAILED, OK, seconds
from play_launch.control.protocol import Code, ControlError

if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

    from play_launch.control.client import ControlClient

_LIMIT: Final = 5.0
_NAME: Final = "full name, or its last part where only one has it"


def add_arguments(parser: ArgumentParser, verb: str) -> None:  # noqa: ARG001 - as for all verbs
    """Declare what it takes."""
    verbs = parser.add_subparsers(required=True, metavar="get|set|dump", dest="what")
    get = verbs.add_parser("get", help="print the values of parameters of a node")
    get.add_argument("node", help=_NAME)
    get.add_argument("parameters", nargs="+", metavar="PARAMETER")
    set_ = verbs.add_parser("set", help="set a parameter of a node")
    set_.add_argument("node", help=_NAME)
    set_.add_argument("parameter", metavar="PARAMETER")
    set_.add_argument("value", help="as YAML; read as the type that the parameter has")
    dump = verbs.add_parser("dump", help="print all parameters of nodes as a parameter file")
    dump.add_argument("nodes", nargs="*", metavar="NODE", help="by default all")
    for each in (get, set_, dump):
        # Also behind the words of the operation.
        each.add_argument("--session", default=SUPPRESS, help=SUPPRESS)
        each.add_argument("--json", action="store_true", default=SUPPRESS, help="for programs")
        each.add_argument("--timeout", type=seconds, default=_LIMIT, metavar="S", help="of a call")


def run(client: ControlClient, options: Namespace) -> int:
    """Do what ``options.what`` says."""
    from play_launch.cli.session_environment import enter_environment_of  # noqa: PLC0415 - slow

    wanted = options.nodes if options.what == "dump" else [options.node]
    rows = client.ask("ps", {"names": wanted})
    is_node = {"component": "loaded", "process": "running"}
    nodes = [row["name"] for row in rows if is_node.get(row["kind"]) == row["state"]]
    if not nodes:
        found = ", ".join(f"{row['name']} is a {row['kind']}, {row['state']}" for row in rows)
        is_any = f": {found}" if wanted else ""
        raise ControlError(
            Code.REFUSED, f"only loaded components and running processes have parameters{is_any}"
        )
    if options.what != "dump" and len(nodes) > 1:
        raise ControlError(Code.AMBIGUOUS_NAME, f"{wanted[0]} are {len(nodes)} nodes; name one")
    enter_environment_of(client)
    from play_launch.ros.node_parameters import NodeParameters  # noqa: PLC0415 - slow
    from play_launch.ros.node_services import NodeServiceError  # noqa: PLC0415

    with NodeParameters(options.timeout) as parameters:
        try:
            match options.what:
                case "get":
                    _print_values(parameters.get(nodes[0], options.parameters), options)
                case "set":
                    parameters.set(nodes[0], options.parameter, options.value)
                    if options.json:
                        _print_values(parameters.get(nodes[0], [options.parameter]), options)
                case _:
                    return _dump(parameters, nodes, options, is_picked=bool(wanted))
        except (NodeServiceError, ValueError) as error:
            raise ControlError(Code.FAILED, str(error)) from None
    return OK


def _print_values(values: dict[str, Any], options: Namespace) -> None:
    if options.json:
        sys.stdout.write(f"{json.dumps(values)}\n")
        return
    for name, value in values.items():
        text = value if isinstance(value, str) else json.dumps(value)
        sys.stdout.write(f"{name}: {text}\n" if len(values) > 1 else f"{text}\n")


def _dump(parameters: Any, nodes: list[str], options: Namespace, *, is_picked: bool) -> int:
    from play_launch.ros.node_services import NodeServiceError  # noqa: PLC0415 - as above

    found: dict[str, Any] = {}
    missing: list[str] = []
    for node in nodes:
        try:
            found[node] = parameters.dump(node)
        except NodeServiceError as error:
            missing.append(str(error))
    if options.json:
        sys.stdout.write(f"{json.dumps(found)}\n")
    elif found:
        import yaml  # noqa: PLC0415 - not for the others

        values = {node: {"ros__parameters": each} for node, each in found.items()}
        sys.stdout.write(yaml.safe_dump(values, sort_keys=True, default_flow_style=None))
    for each in missing:
        sys.stderr.write(f"{'error' if is_picked else 'left out'}: {each}\n")
    return FAILED if missing and (is_picked or not found) else OK
