"""Frames are read as containers write them, and equal crashes have equal signatures."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.supervisor.frames import (
    StackFrame,
    blamed,
    blamed_line,
    frame_of,
    plain_function,
    signature_of,
)

OFFSETS = st.integers(0, 2**40)
FUNCTIONS = st.sampled_from(["demo::Talker::tick()", "main", "a::b<int (*)(char)>::c(int)", "f"])
LIBRARIES = st.sampled_from(["libdemo.so", "librobot.so.1", "program"])


@given(st.integers(0, 99), FUNCTIONS, OFFSETS, LIBRARIES, OFFSETS)
def test_a_frame_is_read(number: int, function: str, inside: int, library: str, at: int) -> None:
    text = f"#{number} {function}+0x{inside:x} ({library}+0x{at:x})"
    assert frame_of(text) == StackFrame(text, function, library, at)
    text = f"#{number} {library}+0x{at:x}"
    assert frame_of(text) == StackFrame(text, "", library, at)


@given(st.text(max_size=50))
def test_what_is_no_frame_is_kept_as_text(text: str) -> None:
    assert frame_of(text).text == text


def test_an_address_without_a_library_is_a_frame_without_a_place() -> None:
    assert frame_of("#0 0x4141") == StackFrame("#0 0x4141")


@given(st.lists(st.tuples(FUNCTIONS, LIBRARIES), min_size=1, max_size=9), st.data())
def test_addresses_do_not_matter_for_a_signature(
    calls: list[tuple[str, str]], data: st.DataObject
) -> None:
    def frame(number: int, function: str, library: str) -> StackFrame:
        inside, at = data.draw(OFFSETS), data.draw(OFFSETS)
        return frame_of(f"#{number} {function}+0x{inside:x} ({library}+0x{at:x})")

    def trace() -> list[StackFrame]:
        return [frame(number, *call) for number, call in enumerate(calls)]

    first = signature_of("SIGSEGV", trace(), "/talker")
    second = signature_of("SIGSEGV", trace(), "/listener")
    assert first == second
    assert first.id == second.id
    assert signature_of("SIGABRT", trace(), "/talker").id != first.id


@pytest.mark.parametrize(
    ("name", "plain"),
    [
        ("demo::Talker::tick()", "demo::Talker::tick"),
        ("demo::(anonymous namespace)::die(std::string const&)", "demo::die"),
        ("f(int) [clone .cold]", "f"),
        ("g.isra.0", "g"),
        ("demo::kWays::{lambda()#1}::_FUN()", "demo::kWays::{lambda}::_FUN"),
        ("std::function<void (int)>::operator()(int) const", "std::function::operator()"),
        ("X::operator<< <int>(int)", "X::operator<<"),
        ("X::operator->() const", "X::operator->"),
    ],
)
def test_a_name_is_the_same_in_every_build(name: str, plain: str) -> None:
    assert plain_function(name) == plain


def test_runtime_and_framework_are_not_to_blame() -> None:
    lines = (
        "#0 abort+0x1 (libc.so.6+0x1)",
        "#1 __cxa_throw+0x1 (libstdc++.so.6+0x1)",
        "#2 demo::f()+0x1 (libdemo.so+0x1)",
        "#3 rclcpp::Executor::spin()+0x1 (librclcpp.so+0x1)",
    )
    frames = [frame_of(line) for line in lines]
    assert blamed(frames) == 2
    assert signature_of("SIGABRT", frames, "").frames == ("demo::f (libdemo.so)",)
    assert blamed([*frames[:2], frames[3]]) == 2
    assert blamed(frames[:2]) == 0
    assert blamed([]) is None


def test_the_one_line_that_is_shown_is_that_of_the_user_though_abort_is_the_containers() -> None:
    lines = ("#0 syscall+0x1 (libc.so.6+0x1)", "#1 abort+0x63 (component_container+0x1)")
    assert blamed_line([*lines, "#2 libdemo.so+0x1"]) == "#2 libdemo.so+0x1"
    assert blamed_line(lines) == lines[1]
    assert blamed_line([]) == ""


def test_without_a_backtrace_the_signature_is_the_signal() -> None:
    assert str(signature_of("SIGKILL", [], "/box")) == "SIGKILL in /box"
