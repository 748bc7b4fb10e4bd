"""Test processes preload what they should, and only they."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

LIBRARY = "condition_deadline.so"


@pytest.mark.skipif(
    "PYTEST_XDIST_WORKER" not in os.environ, reason="tests run in one process: nothing is preloaded"
)
def test_a_test_process_preloads_it_and_its_children_do_not() -> None:
    assert LIBRARY in Path("/proc/self/maps").read_text()
    code = "print(open('/proc/self/maps').read())"
    maps = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert LIBRARY not in maps.stdout
