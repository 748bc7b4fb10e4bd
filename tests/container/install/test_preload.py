"""What is preloaded, in which order, and what ordinary processes get."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from play_launch.container.environment import preloaded_in, preloading, with_safe_waits
from play_launch.container.ros import component_container

CONTAINER = Path("/p/component_container")
LIBRARY = "/p/libfastdds_waits.so"
ASAN = "verify_asan_link_order=0"
LOCKING_TWICE = """
import ctypes
c = ctypes.CDLL(None)
mutex, attributes, passed = (ctypes.create_string_buffer(64) for _ in range(3))
c.pthread_mutexattr_init(attributes)
c.pthread_mutexattr_setpshared(attributes, 1)
c.pthread_mutex_init(mutex, attributes)
print(c.pthread_mutex_timedlock(mutex, passed), c.pthread_mutex_timedlock(mutex, passed))
"""


@pytest.mark.parametrize(
    ("before", "last", "after"),
    [
        ({}, False, ["/l/liba.so"]),
        ({"LD_PRELOAD": "libb.so /x/libc.so"}, False, ["/l/liba.so", "libb.so", "/x/libc.so"]),
        ({"LD_PRELOAD": "libb.so:/x/libc.so"}, True, ["libb.so", "/x/libc.so", "/l/liba.so"]),
    ],
)
def test_a_library_is_added(before: dict[str, str], last: bool, after: list[str]) -> None:
    assert preloaded_in(preloading(before, Path("/l/liba.so"), last=last)) == after


def test_in_a_folder_with_a_space_it_is_searched_for() -> None:
    changed = preloading({"LD_LIBRARY_PATH": "/x"}, Path("/a b/liba.so"))
    assert changed == {"LD_PRELOAD": "liba.so", "LD_LIBRARY_PATH": "/a b:/x"}


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ({}, {"LD_PRELOAD": LIBRARY, "ASAN_OPTIONS": ASAN}),
        (
            {"LD_PRELOAD": "libasan.so.8", "ASAN_OPTIONS": "detect_leaks=0"},
            {"LD_PRELOAD": f"libasan.so.8:{LIBRARY}", "ASAN_OPTIONS": f"{ASAN}:detect_leaks=0"},
        ),
        ({"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}, None),
        ({"PLAY_LAUNCH_FASTDDS_WAITS": "0"}, None),
    ],
    ids=["plain", "others before", "another middleware", "switched off"],
)
def test_ordinary_processes_get_it_with_fast_dds(
    before: dict[str, str], after: dict[str, str] | None
) -> None:
    assert with_safe_waits(before, CONTAINER) == (before if after is None else before | after)


@pytest.mark.parametrize("before", [{}, {"LD_PRELOAD": "libx.so", "ASAN_OPTIONS": "a=1:b=2"}])
def test_a_session_in_a_session_preloads_it_once(before: dict[str, str]) -> None:
    once = with_safe_waits(before, CONTAINER)
    assert with_safe_waits(once, CONTAINER) == once


def test_a_program_gets_its_own_mutex_again() -> None:
    environment = with_safe_waits(os.environ, component_container())
    command = [sys.executable, "-c", LOCKING_TWICE]
    done = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("0 0\n", "")


def test_a_program_with_a_sanitizer_starts(tmp_path: Path) -> None:
    source, program = tmp_path / "leaks_not.c", tmp_path / "leaks_not"
    source.write_text('#include <stdio.h>\nint main(void) { return puts("started") < 0; }\n')
    compiler = os.environ.get("CC", "cc")
    built = subprocess.run(
        [compiler, "-fsanitize=address", "-o", program, source], check=False, capture_output=True
    )
    if built.returncode != 0:
        pytest.skip(f"{shutil.which(compiler) or compiler} has no AddressSanitizer")
    environment = with_safe_waits(os.environ, component_container())
    done = subprocess.run([program], env=environment, check=False, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "started\n"), done.stderr
