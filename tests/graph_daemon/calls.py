"""The calls whose answers were recorded from ros2cli's own daemon."""

from __future__ import annotations

from typing import Any

from play_launch.graph_daemon.contract import GRAPH_METHODS
from tests.graph_daemon.scene import NODES, SERVICE, TOPICS

Call = tuple[str, list[Any]]

BY_NODE = [method for method in GRAPH_METHODS if method.endswith("_by_node")]
BY_TOPIC = ["get_publishers_info_by_topic", "get_subscriptions_info_by_topic"]
COUNTS = ["count_publishers", "count_subscribers", "count_clients", "count_services"]
ALL_AT_ONCE = [
    method for method in GRAPH_METHODS if method not in {*BY_NODE, *BY_TOPIC, *COUNTS, "get_name"}
]


def calls() -> list[Call]:
    return [*introspection(), *about_the_graph(), *mistakes()]


def introspection() -> list[Call]:
    system = ["listMethods", "methodHelp", "methodSignature", "shutdown"]
    names = [*GRAPH_METHODS, *(f"system.{name}" for name in system), "unknown", ""]
    return [
        ("system.listMethods", []),
        *(("system.methodHelp", [name]) for name in names),
        ("system.methodSignature", ["get_name"]),
        ("system.methodSignature", ["unknown"]),
    ]


def about_the_graph() -> list[Call]:
    found: list[Call] = [(method, []) for method in ALL_AT_ONCE]
    found += [("get_topic_names_and_types", [no_demangle]) for no_demangle in (False, True)]
    found += [(method, list(node)) for method in BY_NODE for node in NODES]
    found += [("get_publisher_names_and_types_by_node", ["talker", "/", True])]
    found += [("get_subscriber_names_and_types_by_node", ["listener", "/", True])]
    found += [(method, [topic]) for method in BY_TOPIC for topic in (*TOPICS, "/nobody", "chatter")]
    found += [(method, ["rt/chatter", True]) for method in BY_TOPIC]
    found += [(method, ["/rosout", False]) for method in BY_TOPIC]
    found += [(method, [name]) for method in COUNTS for name in (*TOPICS, SERVICE, "chatter")]
    return found


def mistakes() -> list[Call]:
    found: list[Call] = [
        ("unknown", []),
        ("", []),
        ("_dispatch", []),
        ("system.multicall", [[]]),
        ("get_node_names_and_namespaces.__class__", []),
        ("system.listMethods", [1]),
        ("system.methodHelp", []),
        ("get_topic_names_and_types", ["yes"]),
        ("get_topic_names_and_types", [True, True]),
        ("get_publishers_info_by_topic", ["/chatter", "no"]),
        ("get_publishers_info_by_topic", []),
        ("get_name", [{"a": [1, 2.5, None, True]}]),
    ]
    found += [(method, [1]) for method in ALL_AT_ONCE if method != "get_topic_names_and_types"]
    found += [(method, []) for method in BY_NODE]
    found += [(method, ["nobody", "/"]) for method in BY_NODE]
    found += [(method, ["talker", "nowhere"]) for method in BY_NODE]
    found += [(method, ["bad name", "/"]) for method in BY_NODE]
    found += [
        (method, [name])
        for method in (*BY_TOPIC, *COUNTS)
        for name in ("bad name", "", "a//b", "ünï", "<&>", 5, None)
    ]
    return found
