"""Messages to frames and back."""

from __future__ import annotations

import pytest

from play_launch.config.model import ParameterConfig, ParameterType, ParameterValue
from play_launch.container.codec import (
    EncodeError,
    Frame,
    FrameKind,
    MessageError,
    decode_message,
    encode_message,
)
from play_launch.container.messages import Cancel, Load, Outgoing, Query


def test_an_unknown_kind_is_nothing() -> None:
    assert decode_message(Frame(99, 1, b"whatever")) is None


def test_an_unknown_kind_of_event_is_an_error() -> None:
    from play_launch_msgs.msg import ComponentEvent
    from rclpy.serialization import serialize_message

    payload = bytes(serialize_message(ComponentEvent(event_type=200)))
    with pytest.raises(MessageError, match="EVENT"):
        decode_message(Frame(FrameKind.EVENT, 1, payload))


@pytest.mark.parametrize(
    "message",
    [
        Cancel(unique_id=-1),
        Cancel(unique_id=2**64),
        Query(query_id=1, unique_ids=(-1,)),
        Load(attempt=1, package_name="p", plugin_name="c", log_level=256),
        Load(
            attempt=1,
            package_name="p",
            plugin_name="c",
            parameters=(ParameterConfig("p", ParameterValue(ParameterType.INTEGER, 2**63)),),
        ),
        Load(attempt=1, package_name="p" * 2**24, plugin_name="c"),
    ],
)
def test_what_does_not_fit_is_an_error_of_ours(message: Outgoing) -> None:
    with pytest.raises(EncodeError, match=type(message).__name__) as caught:
        encode_message(message)
    assert caught.value.message is message


@pytest.mark.parametrize("text", ["a\0b", "\udc80"])
def test_text_that_ros_cannot_hold_is_refused_and_not_changed(text: str) -> None:
    value = ParameterValue(ParameterType.STRING_ARRAY, (text,))
    message = Load(
        attempt=1,
        package_name="p",
        plugin_name="c",
        parameters=(ParameterConfig("p", value),),
    )
    with pytest.raises(EncodeError, match="Load"):
        encode_message(message)
