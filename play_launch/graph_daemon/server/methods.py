"""The methods of the daemon: those of ros2cli's, and one of our own.

Introspection (``system.listMethods``, ``methodHelp``, ``methodSignature``) is that of Python's
XML-RPC server, as in ros2cli. Our own method is not listed there: the list is one of the answers
that must not differ.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final
from xmlrpc.server import SimpleXMLRPCDispatcher

from play_launch.graph_daemon.contract import GRAPH_METHODS, SHUTDOWN_METHOD, STATUS_METHOD
from play_launch.graph_daemon.server.marshal import dump_fault, dump_response, parse_call

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

_SHUTDOWN_HELP: Final = "# function to shutdown daemon remotely"
"""What ros2cli's daemon answers when it is asked for help with this method."""


@dataclass(frozen=True, slots=True)
class Call:
    """What a client asks for; the method is None when the request names none."""

    method: str | None
    arguments: tuple[object, ...]

    @property
    def is_about_the_graph(self) -> bool:
        """Whether the answer depends on the graph, and stays the same until the graph changes."""
        return self.method in GRAPH_METHODS


def parse(body: bytes) -> Call | bytes:
    """Return the call in a request's body, or the response, a fault, when there is none."""
    try:
        method, arguments = parse_call(body)
    except Exception as error:  # noqa: BLE001 - foreign bytes raise many kinds
        return dump_fault(error)
    return Call(method, arguments)


class Methods:
    """Answers calls.

    Args:
        functions: The functions behind the graph's methods, by name. They answer in plain values,
            `Tagged` and `TaggedStruct`, and raise whatever they like: it becomes a fault.
        status: Gives the JSON text of our own method.
        shutdown: Called when a client asks the daemon to end.
    """

    def __init__(
        self,
        functions: Mapping[str, Callable[..., Any]],
        *,
        status: Callable[..., str],
        shutdown: Callable[[], None],
    ) -> None:
        self._dispatcher = SimpleXMLRPCDispatcher(allow_none=True)
        self._dispatcher.register_introspection_functions()
        for name, function in functions.items():
            self._dispatcher.register_function(function, name)

        def on_shutdown() -> None:
            shutdown()

        on_shutdown.__doc__ = _SHUTDOWN_HELP
        self._dispatcher.register_function(on_shutdown, SHUTDOWN_METHOD)
        self._status = status

    def answer(self, call: Call) -> bytes:
        """Make the call and return the body of the response, which may be a fault."""
        try:
            return dump_response(self._result(call))
        except Exception as error:  # noqa: BLE001 - whatever it is, it is reported to the client
            return dump_fault(error)

    def _result(self, call: Call) -> object:
        if call.method == STATUS_METHOD:
            return self._status(*call.arguments)
        # It is meant to be called from outside: its documentation describes how to override it.
        return self._dispatcher._dispatch(call.method, call.arguments)  # type: ignore[arg-type]  # noqa: SLF001
