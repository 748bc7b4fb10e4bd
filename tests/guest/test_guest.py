"""What this machine's kernel lacks is tested in a virtual machine, where there is one to be had."""

from __future__ import annotations

import pytest

from tests.guest.__main__ import SKIPPED, main

LIMIT = 4000


def in_a_virtual_machine(capsys: pytest.CaptureFixture[str], *arguments: str) -> None:
    """Skip the test where there is none."""
    status = main(arguments)
    output = capsys.readouterr().out
    if status == SKIPPED:
        pytest.skip(output.strip())
    assert status == 0, output


@pytest.mark.timeout(LIMIT)
def test_cases_in_a_virtual_machine(capsys: pytest.CaptureFixture[str]) -> None:
    in_a_virtual_machine(capsys)
