from __future__ import annotations

import pytest
from hypothesis import given, settings

from play_launch.cli.top.operations import Proposal, Refusal, Wish, offered, proposal
from play_launch.cli.top.rows import Row, Subject
from play_launch.control.actions import FOR_MEMBERS, FOR_NODES
from tests.cli.top.rows import node, row, systems

AGAIN, HALT, GO = Wish


def known(*rows: Row) -> dict[Subject, Row]:
    return {each.subject: each for each in rows}


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
    assert {name for _, name in offered(one, known(one))} == operations


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
    assert {name for _, name in offered(one, known(container, one))} == operations


def test_a_node_of_a_stopped_container_cannot_be_loaded() -> None:
    container, one = row("/c", "stopped"), node("/a", "/c", "unloaded")
    found = proposal(GO, one, known(container, one))
    assert found == Refusal("/c is stopped, so /a cannot be loaded: start /c first")


@pytest.mark.parametrize(
    ("wish", "states", "question"),
    [
        (AGAIN, ["loaded", "loaded"], "restart /c? Its 2 nodes are loaded again."),
        (AGAIN, ["loaded", "unloaded"], "restart /c? Its node is loaded again."),
        (HALT, ["loaded"], "stop /c? Its node goes with it."),
        (HALT, ["loaded", "loaded"], "stop /c? Its 2 nodes go with it."),
        (HALT, [], "stop /c?"),
    ],
)
def test_a_question_says_what_else_it_affects(wish: Wish, states: list[str], question: str) -> None:
    container = row("/c")
    nodes = [node(f"/{number}", "/c", state) for number, state in enumerate(states)]
    others = [node("/x", "/other"), row("/other")]
    found = proposal(wish, container, known(container, *nodes, *others))
    assert isinstance(found, Proposal)
    assert found.question == question


def test_a_question_about_a_hostile_name_is_harmless() -> None:
    found = proposal(HALT, row("/\x1b[2Ja\n猫"), {})
    assert isinstance(found, Proposal)
    assert found.question == "stop /a 猫?"
    assert found.subject.name == "/\x1b[2Ja\n猫", "the operation is about the real name"


@settings(max_examples=25)
@given(systems())
def test_operations_suit_their_rows(rows: list[Row]) -> None:
    for each in rows:
        for wish in Wish:
            found = proposal(wish, each, known(*rows))
            if isinstance(found, Refusal):
                assert found.reason
                continue
            assert found.operation in (FOR_NODES if each.container else FOR_MEMBERS)
            assert found.subject == each.subject
