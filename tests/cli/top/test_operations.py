from __future__ import annotations

import pytest

from play_launch.cli.session_model import OPERATIONS, Confirmation, confirmation, suits
from play_launch.control.protocol import MEMBER_ACTIONS, NODE_ACTIONS
from tests.cli.top.rows import node, row


def test_each_kind_of_row_has_the_operations_of_the_session() -> None:
    assert {each for each in OPERATIONS if suits(each, row("/c"))} <= set(MEMBER_ACTIONS)
    assert {each for each in OPERATIONS if suits(each, node("/a", "/c"))} <= set(NODE_ACTIONS)


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
    expected = Confirmation("stop", name, "stop /a 猫?")
    assert confirmation("stop", row(name), []) == expected
