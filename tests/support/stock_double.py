"""A component container for tests of faults: it offers ROS's services and misbehaves.

It is run as a program, by the supervisor or by a test, and constructs nodes that are names only.
What goes wrong is said by the nodes themselves: parameter ``faults`` is a list of strings, the
first for the first load of a node of that name, and so on; after its end all is well.

=================  ===============================================================================
``slow:S``         the constructor takes S seconds, and nothing is answered meanwhile
``hang``           it never returns
``lose_request``   the request never came: nothing is constructed, nothing answered
``lose_answer``    the node is there, the answer is lost
``fail``           the constructor throws
``die``            the process is killed in the middle of the constructor
``keep``           loads as it should; an unload says that it failed the first time
=================  ===============================================================================

Option ``--mute-lists N``: the first N requests for the list are not answered.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import rclpy
from composition_interfaces.srv import ListNodes, LoadNode, UnloadNode
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from rclpy.utilities import ok, remove_ros_args, try_shutdown

STATE = "STOCK_DOUBLE_STATE"
"""Environment variable: a folder for the journal and for what outlives the process."""
JOURNAL = "journal.txt"


class StockDouble(Node):
    def __init__(self, options: argparse.Namespace) -> None:
        super().__init__("ComponentManager")
        self._state = Path(os.environ[STATE])
        self._options = options
        self._nodes: dict[int, str] = {}
        self._kept: set[str] = set()
        self._next_id = 1
        self._is_mute = False
        self._muted_lists = 0
        self._threads = threading.local()
        services = (
            (LoadNode, "load_node", self._load),
            (UnloadNode, "unload_node", self._unload),
            (ListNodes, "list_nodes", self._list),
        )
        for kind, name, callback in services:
            service = self.create_service(kind, f"~/_container/{name}", callback)
            self._answer_unless_mute(service)

    def _answer_unless_mute(self, service: Any) -> None:
        send = service.send_response

        def answer(response: Any, header: Any) -> None:
            if getattr(self._threads, "mute", False):
                self._threads.mute = False
            else:
                send(response, header)

        service.send_response = answer

    def _journal(self, *words: object) -> None:
        with (self._state / JOURNAL).open("a") as journal:
            journal.write(" ".join(map(str, (os.getpid(), *words))) + "\n")

    def _fault(self, request: Any, full_name: str) -> tuple[str, float]:
        """The fault of this load and its number."""
        counter = self._state / full_name.strip("/").replace("/", ".")
        number = len(counter.read_text()) if counter.exists() else 0
        with counter.open("a") as file:
            file.write("x")
        faults = next(
            (list(p.value.string_array_value) for p in request.parameters if p.name == "faults"), []
        )
        fault, _, seconds = (faults[number] if number < len(faults) else "").partition(":")
        return fault, float(seconds or 0)

    def _load(self, request: Any, response: Any) -> Any:
        name = request.node_name or request.plugin_name.rpartition("::")[2].lower()
        full_name = f"{request.node_namespace.rstrip('/')}/{name}"
        fault, seconds = self._fault(request, full_name)
        self._journal("load", full_name, fault)
        if fault == "lose_request":
            self._threads.mute = True
            return response
        if fault == "die":
            os.kill(os.getpid(), signal.SIGKILL)
        if fault == "hang":
            threading.Event().wait()
        time.sleep(seconds)
        unique_id, self._next_id = self._next_id, self._next_id + 1
        response.full_node_name, response.unique_id = full_name, unique_id
        response.success = fault != "fail"
        if response.success:
            self._nodes[unique_id] = full_name
            self._journal("construct", full_name, unique_id)
        else:
            response.error_message = "Component constructor threw an exception: as told"
        if fault == "keep":
            self._kept.add(full_name)
        self._threads.mute = fault == "lose_answer"
        return response

    def _unload(self, request: Any, response: Any) -> Any:
        name = self._nodes.get(request.unique_id)
        if name is None or name in self._kept:
            self._kept.discard(name or "")
            response.error_message = f"No node found with unique_id: {request.unique_id}"
            return response
        del self._nodes[request.unique_id]
        self._journal("destroy", name, request.unique_id)
        response.success = True
        return response

    def _list(self, _request: Any, response: Any) -> Any:
        if self._muted_lists < self._options.mute_lists:
            self._muted_lists += 1
            self._threads.mute = True
            return response
        response.unique_ids = list(self._nodes)
        response.full_node_names = list(self._nodes.values())
        return response


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--mute-lists", type=int, default=0)
    options = parser.parse_args(remove_ros_args(sys.argv)[1:])
    rclpy.init()
    # With one thread in the group the callbacks wait for one another all the same.
    executor = MultiThreadedExecutor(num_threads=8)
    node = StockDouble(options)
    executor.add_node(node)
    try:
        with suppress(KeyboardInterrupt, ExternalShutdownException):
            executor.spin()
    except Exception:
        # rclpy's executor trips over the end of its context now and then; a container does not.
        if ok():
            raise
    # So that it leaves the graph at once, and not when its lease is over.
    node.destroy_node()
    try_shutdown()
    # A constructor that hangs keeps a thread, as it would keep the process of a real container.
    sys.stdout.flush()
    os._exit(0)


if __name__ == "__main__":
    main()
