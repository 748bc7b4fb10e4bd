from __future__ import annotations

import pytest

from play_launch.cli.top.rows import (
    OPERATIONS,
    Confirmation,
    Row,
    RowId,
    confirmation,
    suits,
    unavailable,
)
from play_launch.control.actions import FOR_MEMBERS, FOR_NODES
from tests.cli.top.rows import node, row


def known(*rows: Row) -> dict[RowId, Row]:
    return {each.subject: each for each in rows}


def offered(one: Row, rows: dict[RowId, Row]) -> set[str]:
    return {each for each in OPERATIONS if suits(each, one) and not unavailable(each, one, rows)}


def test_each_kind_of_row_has_the_operations_of_the_session() -> None:
    assert {each for each in OPERATIONS if suits(each, row("/c"))} <= set(FOR_MEMBERS)
    assert {each for each in OPERATIONS if suits(each, node("/a", "/c"))} <= set(FOR_NODES)


@pytest.mark.parametrize(
    ("state", "operations"),
    [
        ("running", {"restart", "stop"}),
        ("starting", {"restart", "stop"}),
        ("waiting", {"stop"}),
        ("backoff", {"restart", "stop", "start"}),
        ("stopped", {"restart", "start"}),
        ("exited", {"restart", "start"}),
        ("gave up", {"restart", "start"}),
        ("killing", {"stop"}),
        ("stopping", set()),
        ("of a later version", {"restart", "stop", "start"}),
    ],
)
def test_what_can_be_done_to_a_process(state: str, operations: set[str]) -> None:
    one = row("/a", state, "process")
    assert offered(one, known(one)) == operations


@pytest.mark.parametrize(
    ("state", "operations"),
    [
        ("pending", {"unload", "load"}),
        ("requested", {"reload", "unload"}),
        ("loading", {"reload", "unload"}),
        ("loaded", {"reload", "unload"}),
        ("unloading", set()),
        ("unloaded", {"reload", "load"}),
        ("load failed", {"reload", "unload", "load"}),
        ("crashed", {"reload", "unload", "load"}),
        ("gave up", {"reload", "unload", "load"}),
        ("lost", {"reload", "unload", "load"}),
    ],
)
def test_what_can_be_done_to_a_node(state: str, operations: set[str]) -> None:
    one, container = node("/a", "/c", state), row("/c")
    assert offered(one, known(container, one)) == operations


def test_a_node_of_a_stopped_container_cannot_be_loaded() -> None:
    container, one = row("/c", "stopped"), node("/a", "/c", "unloaded")
    found = unavailable("load", one, known(container, one))
    assert found == "/c is stopped, so /a cannot be loaded: start /c first"


@pytest.mark.parametrize(
    ("operation", "states", "question"),
    [
        ("restart", ["loaded", "loaded"], "restart /c? Its 2 nodes will be reloaded."),
        ("restart", ["loaded", "unloaded"], "restart /c? Its node will be reloaded."),
        ("stop", ["loaded"], "stop /c? Its node will be unloaded."),
        ("stop", [], "stop /c?"),
    ],
)
def test_a_question_names_what_else_is_affected(
    operation: str, states: list[str], question: str
) -> None:
    nodes = [node(f"/{number}", "/c", state) for number, state in enumerate(states)]
    rows = [row("/c"), *nodes, node("/x", "/other"), row("/other")]
    assert confirmation(operation, rows[0], rows).question == question


def test_a_question_about_a_hostile_name_is_harmless() -> None:
    name = "/\x1b[2Ja\n猫"
    expected = Confirmation("stop", RowId(None, name), "stop /a 猫?")
    assert confirmation("stop", row(name), []) == expected
