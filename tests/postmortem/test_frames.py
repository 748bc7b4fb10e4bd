"""Frames are read as containers write them, and equal crashes have equal signatures."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from play_launch.postmortem.frames import (
    Frame,
    blamed,
    ending,
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
    assert frame_of(text) == Frame(text, function, library, at)
    text = f"#{number} {library}+0x{at:x}"
    assert frame_of(text) == Frame(text, "", library, at)


@given(st.text(max_size=50))
def test_what_is_no_frame_is_kept_as_text(text: str) -> None:
    assert frame_of(text).text == text


def test_an_address_without_a_library_is_a_frame_without_a_place() -> None:
    assert frame_of("#0 0x4141") == Frame("#0 0x4141")


@given(st.lists(st.tuples(FUNCTIONS, LIBRARIES), min_size=1, max_size=9), st.data())
def test_addresses_do_not_matter_for_a_signature(
    calls: list[tuple[str, str]], data: st.DataObject
) -> None:
    def frame(number: int, function: str, library: str) -> Frame:
        inside, at = data.draw(OFFSETS), data.draw(OFFSETS)
        return frame_of(f"#{number} {function}+0x{inside:x} ({library}+0x{at:x})")

    def trace() -> list[Frame]:
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


@pytest.mark.parametrize(
    ("signal", "code", "reason", "what"),
    [
        (11, 0, "SIGSEGV (no memory at address 0x0)", "SIGSEGV"),
        (6, 0, "SIGABRT (uncaught exception std::runtime_error: no) in", "std::runtime_error"),
        (6, 0, "SIGABRT (uncaught exception int) in thread", "int"),
        (0, 3, "", "exit status 3"),
        (77, 0, "", "signal 77"),
    ],
)
def test_how_it_ended_in_a_word(signal: int, code: int, reason: str, what: str) -> None:
    assert ending(signal, code, reason) == what


def test_without_a_backtrace_it_is_who_it_was() -> None:
    assert str(signature_of("SIGKILL", [], "/box")) == "SIGKILL in /box"
