"""2 MB by pointer from process to process."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from std_msgs.msg import String

from tests.support.isolated import ALL_MODES, start

if TYPE_CHECKING:
    from tests.support.control_peer import StartContainer
    from tests.support.ros import Probe


@pytest.mark.parametrize("mode", ALL_MODES)
def test_the_sink_gets_the_very_image(
    spawn: StartContainer, components: str, mode: str, probe: Probe
) -> None:
    container = start(spawn, mode)
    by_pointer = {"use_intra_process_comms": True}
    sink = container.loaded("ImageSink", package=components, extra_arguments=by_pointer)
    source = container.loaded("ImageSource", package=components, extra_arguments=by_pointer)
    for verdict in probe.collect(String, "/verdict", 20, timeout=60.0):
        made_by, made_at, seen_by, seen_at = verdict.data.split()
        assert (int(made_by), int(seen_by)) == (source.pid, sink.pid)
        assert made_at == seen_at
    assert (source.pid == sink.pid) == (not mode.startswith("isolated"))
    assert container.shut_down() == 0, container.log.read_text()


@pytest.mark.parametrize("mode", ["standard", "isolated"])
def test_without_intra_process_it_is_a_copy(
    spawn: StartContainer, components: str, mode: str, probe: Probe
) -> None:
    container = start(spawn, mode)
    container.loaded("ImageSink", package=components)
    container.loaded("ImageSource", package=components)
    for verdict in probe.collect(String, "/verdict", 3, timeout=60.0):
        _, made_at, _, seen_at = verdict.data.split()
        assert made_at != seen_at
    assert container.shut_down() == 0, container.log.read_text()
