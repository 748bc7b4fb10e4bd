"""Names of ROS 2: ours are at least as strict as rmw's."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.validate_full_topic_name import validate_full_topic_name
from rclpy.validate_namespace import validate_namespace
from rclpy.validate_node_name import validate_node_name
from rclpy.validate_topic_name import validate_topic_name

from play_launch.config.values import check_namespace, check_node_name, check_topic, join_full_name

# Short alphabets, so that the odd characters meet often.
TOKENS = st.text("aZ_09/~é. -", max_size=8)
LENGTHS = st.integers(240, 260).map(lambda length: "a" * length)


@given(TOKENS | LENGTHS)
def test_accepted_node_names_are_names_to_ros(name: str) -> None:
    try:
        check_node_name(name)
    except ValueError:
        return
    assert validate_node_name(name)


@given(TOKENS | LENGTHS)
def test_accepted_namespaces_are_namespaces_to_ros(namespace: str) -> None:
    try:
        absolute = check_namespace(namespace)
    except ValueError:
        return
    assert validate_namespace(absolute)


@given(TOKENS | LENGTHS | st.text("aZ_0/", max_size=4).map("/{}".format))
def test_accepted_topics_are_topics_to_ros(topic: str) -> None:
    try:
        check_topic(topic)
    except ValueError:
        return
    assert validate_topic_name(topic)
    if topic.startswith("/"):
        assert validate_full_topic_name(topic)


@pytest.mark.parametrize("name", ["a", "_a", "A1", "front_camera", "a" * 255])
def test_node_names(name: str) -> None:
    assert check_node_name(name) == name


@pytest.mark.parametrize(
    "name", ["", "1a", "a__b", "__a", "a/b", "/a", "a b", "ä", "a-b", "a" * 256]
)
def test_refused_node_names(name: str) -> None:
    with pytest.raises(ValueError, match=r"name|part|characters"):
        check_node_name(name)


@pytest.mark.parametrize(
    ("written", "absolute"),
    [("/", "/"), ("/a", "/a"), ("a", "/a"), ("a/b_1", "/a/b_1"), ("/_a", "/_a")],
)
def test_namespaces(written: str, absolute: str) -> None:
    assert check_namespace(written) == absolute


@pytest.mark.parametrize("written", ["", "//", "/a/", "a//b", "~", "~/a", "/1", "/a__b", "/a-b"])
def test_refused_namespaces(written: str) -> None:
    with pytest.raises(ValueError, match="namespace"):
        check_namespace(written)


@pytest.mark.parametrize("topic", ["chatter", "/chatter", "~/out", "a/b", "/a/_b/c1"])
def test_topics(topic: str) -> None:
    assert check_topic(topic) == topic


@pytest.mark.parametrize(
    "topic", ["", "/", "~", "~/", "~a", "a/", "/1a", "a//b", "{node}/a", "*", "/**", r"\1", "a__b"]
)
def test_refused_topics(topic: str) -> None:
    with pytest.raises(ValueError, match=r"topic|remapping"):
        check_topic(topic)


def test_full_names() -> None:
    assert join_full_name("/", "a") == "/a"
    assert join_full_name("/a/b", "c") == "/a/b/c"
