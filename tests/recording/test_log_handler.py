"""What Python reports by itself is published once, and nowhere printed."""

from __future__ import annotations

import asyncio
import logging
import threading
import warnings
from typing import TYPE_CHECKING

import pytest

from play_launch.recording.log_handler import log_published

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.core.events import LogRecord


class BadEnd:
    """Cannot be destroyed without an error."""

    def __del__(self) -> None:
        raise ValueError("bad end")


async def callback_fails() -> None:
    asyncio.get_running_loop().call_soon(lambda: 1 // 0)
    await asyncio.sleep(0)
    await asyncio.sleep(0)


async def nobody_asks_a_task() -> None:
    async def fail() -> None:
        raise ValueError("nobody asked")

    task = asyncio.create_task(fail())
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    del task


async def nobody_awaits() -> None:
    asyncio.sleep(0)  # type: ignore[unused-coroutine]


def thread_fails() -> None:
    def fail() -> None:
        raise ValueError("thread failed")

    thread = threading.Thread(target=fail, name="helper")
    thread.start()
    thread.join()


def thread_exits() -> None:
    thread = threading.Thread(target=lambda: exit(1))
    thread.start()
    thread.join()


CASES: list[tuple[Callable[[], object], str, int, str]] = [
    (lambda: asyncio.run(callback_fails()), "asyncio", 40, "ZeroDivisionError"),
    (lambda: asyncio.run(nobody_asks_a_task()), "asyncio", 40, "ValueError: nobody asked"),
    (lambda: asyncio.run(nobody_awaits()), "py.warnings", 30, "never awaited"),
    (lambda: warnings.warn("look out", UserWarning, stacklevel=1), "py.warnings", 30, "look out"),
    (BadEnd, "python", 40, "ValueError: bad end"),
    (thread_fails, "python", 40, "ValueError: thread failed"),
    (lambda: logging.getLogger("library").warning("odd"), "library", 30, "odd"),
]


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize(("cause", "logger", "level", "text"), CASES)
def test_it_is_published_once_and_not_printed(
    cause: Callable[[], object],
    logger: str,
    level: int,
    text: str,
    capfd: pytest.CaptureFixture[str],
) -> None:
    heard: list[LogRecord] = []
    with log_published(heard.append):
        cause()
    (event,) = heard
    assert (event.name, event.level) == (logger, level)
    assert text in event.message
    assert not event.message.endswith("\n")
    assert capfd.readouterr() == ("", "")


def test_a_thread_that_exits_is_no_news(capfd: pytest.CaptureFixture[str]) -> None:
    heard: list[LogRecord] = []
    with log_published(heard.append):
        thread_exits()
    assert not heard
    assert capfd.readouterr() == ("", "")


def test_a_destructor_may_fail_in_the_midst_of_publishing() -> None:
    lock = threading.Lock()
    heard: list[LogRecord] = []

    def publish(event: LogRecord) -> None:
        assert lock.acquire(timeout=20), "the thread waits for itself"
        heard.append(event)
        lock.release()

    with log_published(publish), lock:
        BadEnd()
    assert len(heard) == 1


def test_everything_is_as_before_afterwards() -> None:
    def state() -> tuple[object, ...]:
        ours, root = logging.getLogger("play_launch"), logging.getLogger()
        return (
            *(ours.level, ours.propagate, [*ours.handlers], [*root.handlers]),
            *(threading.excepthook, warnings.showwarning),
        )

    before = state()
    with log_published(lambda _: None):
        assert state() != before
    assert state() == before
