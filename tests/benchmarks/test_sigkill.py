"""Kill a supervisor that records under load: what was recorded is there, whole and in order.

`benchmarks.sigkill_recording` does it a hundred times, and measures what is lost.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from benchmarks import sigkill_recording

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize("after", [0.0, 0.3, 0.8])
def test_what_was_recorded_is_read_by_everybody(
    tmp_path: Path, after: float, ros_domain: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    environment = {**sigkill_recording.ENVIRONMENT, "ROS_DOMAIN_ID": str(ros_domain)}
    monkeypatch.setattr(sigkill_recording, "ENVIRONMENT", environment)
    killed = sigkill_recording.kill_once(tmp_path, 4000.0, after)
    assert killed.gaps == 0
    assert killed.messages > 0 or after == 0.0
    assert killed.lost > 0, "it was killed after its last message"
