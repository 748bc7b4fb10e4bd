"""What this machine's kernel lacks is tested in a virtual machine, where there is one to be had."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

RUNNER = Path(__file__).parent / "run"
SKIPPED = 77
LIMIT = 4000


@pytest.mark.skipif(
    shutil.which("qemu-system-x86_64") is None, reason="qemu-system-x86_64 is not installed"
)
@pytest.mark.timeout(LIMIT)
def test_cases_in_a_virtual_machine() -> None:
    ended = subprocess.run(
        [sys.executable, RUNNER], capture_output=True, text=True, timeout=LIMIT, check=False
    )
    if ended.returncode == SKIPPED:
        pytest.skip(ended.stdout.strip())
    assert ended.returncode == 0, ended.stdout + ended.stderr
