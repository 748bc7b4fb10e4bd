"""What a path can lead to besides a readable text file."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from play_launch.config.load import load_config, parse_config
from play_launch.config.problems import ConfigError, Problem
from play_launch.config.source import LARGEST_FILE, Refused, read_bytes

GOOD = b"version: 1\nnodes:\n  - command: [x]\n"


def open_descriptors() -> set[str]:
    return {entry.name for entry in Path("/dev/fd").iterdir()}


def refusal(path: Path) -> Problem:
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    (problem,) = caught.value.problems
    return problem


def refusal_of(content: bytes) -> Problem:
    with pytest.raises(ConfigError) as caught:
        parse_config(content, Path("demo.yaml"))
    (problem,) = caught.value.problems
    return problem


def test_paths_that_are_no_readable_file(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(GOOD)
    (tmp_path / "dangling.yaml").symlink_to(tmp_path / "gone.yaml")
    (tmp_path / "loop.yaml").symlink_to(tmp_path / "loop.yaml")
    os.mkfifo(tmp_path / "pipe.yaml")  # without a writer: not waited for
    missing = tmp_path / "missing.yaml"
    assert str(refusal(missing)) == f"{missing}:1:1: (file): no such file"
    for name, reason in (
        (".", "is a directory"),
        ("file/demo.yaml", "not a directory"),
        ("dangling.yaml", "symbolic link to a file that does not exist"),
        ("loop.yaml", "too many levels of symbolic links"),
        ("pipe.yaml", "is a pipe or a device; write what comes from it to a file first"),
        ("a\0b", "is not a path"),
    ):
        assert reason in refusal(tmp_path / name).message, name


def test_symbolic_link_is_followed(tmp_path: Path) -> None:
    (tmp_path / "real.yaml").write_bytes(GOOD)
    link = tmp_path / "demo.yaml"
    link.symlink_to(tmp_path / "real.yaml")
    assert load_config(link).name == "demo"


def test_unreadable_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Not by permissions, because those do not hold back root.
    def refuse(*_arguments: object) -> int:
        raise PermissionError(13, "Permission denied")

    path = tmp_path / "demo.yaml"
    path.write_bytes(GOOD)
    monkeypatch.setattr(os, "open", refuse)
    assert "permission denied" in refusal(path).message


def test_too_large_a_file_is_not_parsed(tmp_path: Path) -> None:
    path = tmp_path / "demo.yaml"
    path.write_bytes(GOOD + b"# filled\n" * (10 * 1024 * 1024 // 9))
    assert "larger than 4 MiB" in refusal(path).message


def test_a_file_of_the_largest_size_is_read(tmp_path: Path) -> None:
    path = tmp_path / "demo.yaml"
    path.write_bytes(GOOD.ljust(LARGEST_FILE, b"\n"))
    assert len(load_config(path).text) == LARGEST_FILE


def test_descriptors_are_closed(tmp_path: Path) -> None:
    path = tmp_path / "demo.yaml"
    path.write_bytes(GOOD)
    before = open_descriptors()
    assert read_bytes(path) == GOOD
    assert isinstance(read_bytes(path, largest=3), Refused)
    assert open_descriptors() == before


@pytest.mark.parametrize(
    ("content", "line", "column", "fragment"),
    [
        (b"version: 1\nname: caf\xe9\n", 2, 10, "byte 0xe9 is not UTF-8"),
        ("version: 1\nname: ü".encode() + b"\xff", 2, 8, "byte 0xff is not UTF-8"),
        (b"\xff\xfev\0e\0", 1, 1, "byte 0xff is not UTF-8"),
        (b"v\0e\0r\0", 1, 2, "a NUL byte"),
        (b"version: 1\r\nname: a\0b\r\n", 2, 8, "a NUL byte"),
        (b"version: 1\nname: \x1b[31m\n", 2, 7, "U+001B"),
        ("version: 1\nname: a\ufeffb\n".encode(), 2, 8, "U+FEFF"),
        (b"version: 1\rname: \x01", 2, 7, "U+0001"),
        (b"version: 1\nname: \xed\xa0\x80\n", 2, 7, "byte 0xed is not UTF-8"),
    ],
)
def test_bytes_that_are_no_text(content: bytes, line: int, column: int, fragment: str) -> None:
    problem = refusal_of(content)
    assert (problem.line, problem.column) == (line, column)
    assert fragment in problem.message


def test_a_byte_order_mark_and_dos_line_ends_do_no_harm() -> None:
    config = parse_config(b"\xef\xbb\xbf" + GOOD.replace(b"\n", b"\r\n"), Path("demo.yaml"))
    assert config.nodes[0].command == ("x",)
    assert config.nodes[0].line == 3


def test_a_recording_is_no_configuration(tmp_path: Path) -> None:
    path = tmp_path / "session.mcap"
    path.write_bytes(b"\x89MCAP0\r\n" + bytes(range(256)))
    with pytest.raises(ConfigError, match="is an MCAP recording"):
        load_config(path)
