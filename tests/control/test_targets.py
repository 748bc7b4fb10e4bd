from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.config.node_key import NodeKey
from play_launch.control.protocol import Code, OperationError
from play_launch.control.units import Target, chosen, full_name

MEMBERS: list[Target] = ["/sensing/box", "/chat", "/monitor"]
NODES: list[Target] = [
    NodeKey("/chat", "/talker"),
    NodeKey("/chat", "/listener"),
    NodeKey("/sensing/box", "/sensing/camera"),
    NodeKey("/sensing/box", "/other/camera"),
    NodeKey("/sensing/box", "/[demo::Talker]"),
    NodeKey("/sensing/box", "/talker"),
]
WORD = st.text("abc/*?[]", min_size=1, max_size=6)
NAMES = st.lists(st.text("abc/", min_size=1, max_size=5).map(lambda text: f"/{text}"), max_size=6)


def names(wanted: list[str], candidates: list[Target]) -> list[str]:
    return [str(target) for target in chosen(wanted, candidates)]


@pytest.mark.parametrize(
    ("word", "meant"),
    [
        ("/listener", ["/chat:/listener"]),
        ("listener", ["/chat:/listener"]),
        ("/chat:/talker", ["/chat:/talker"]),
        ("/sensing/*", ["/sensing/box:/sensing/camera"]),
        ("*/camera", ["/sensing/box:/sensing/camera", "/sensing/box:/other/camera"]),
        ("/chat:*", ["/chat:/talker", "/chat:/listener"]),
        ("/[demo::Talker]", ["/sensing/box:/[demo::Talker]"]),
        ("[demo::Talker]", ["/sensing/box:/[demo::Talker]"]),
        ("other/camera", ["/sensing/box:/other/camera"]),
    ],
)
def test_names_and_patterns(word: str, meant: list[str]) -> None:
    assert names([word], NODES) == meant


def test_each_is_found_once_in_the_order_of_declaration() -> None:
    assert names(["/listener", "/chat:*", "/chat:/talker"], NODES) == [
        "/chat:/talker",
        "/chat:/listener",
    ]


@pytest.mark.parametrize(
    ("word", "code", "words"),
    [
        ("camera", Code.AMBIGUOUS_NAME, "/sensing/camera"),
        ("/talker", Code.AMBIGUOUS_NAME, "/sensing/box:/talker"),
        ("/litsener", Code.UNKNOWN_NAME, "did you mean /listener?"),
        ("litsener", Code.UNKNOWN_NAME, "did you mean /listener?"),
        ("cam*", Code.UNKNOWN_NAME, "patterns are over full names: '*/cam*'"),
        ("chat:*", Code.UNKNOWN_NAME, "'*/chat:*'"),
        ("/nothing/*", Code.UNKNOWN_NAME, "ps lists"),
        ("/monitor", Code.BAD_ARGUMENTS, "/monitor is no node"),
        ("", Code.UNKNOWN_NAME, "named"),
    ],
)
def test_what_is_wrong_is_said(word: str, code: str, words: str) -> None:
    with pytest.raises(OperationError) as refused:
        chosen([word], NODES, dict.fromkeys(MEMBERS, "is no node"))
    assert refused.value.code == code
    assert words in str(refused.value)
    assert refused.value.details["name"] == word


@given(NAMES, st.lists(WORD, max_size=3))
def test_what_is_chosen_was_there_and_each_word_has_a_part(
    found: list[str], words: list[str]
) -> None:
    candidates: list[Target] = list(dict.fromkeys(found))
    try:
        meant = chosen(words, candidates)
    except OperationError:
        return
    assert [each for each in candidates if each in meant] == meant
    assert bool(meant) is bool(words)
    assert len(meant) <= len(words) or any(not set("*?[").isdisjoint(word) for word in words)


@given(NAMES.filter(bool))
def test_a_full_name_always_means_its_bearer(found: list[str]) -> None:
    candidates: list[Target] = list(dict.fromkeys(found))
    for each in candidates:
        assert chosen([full_name(each)], candidates) == [each]
