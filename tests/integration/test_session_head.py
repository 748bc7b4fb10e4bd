"""What a recording holds besides messages, of a run as a user runs it."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from tests.recording.reading import attachments
from tests.support.replay import replaying

CONFIG = b"""
version: 1
duration: 1 s
nodes:
  - name: one
    command: [sh, -c, "exec sleep 600"]
    parameters: [params/common.yaml, {rate: 2.0}, more.yaml]
  - name: two
    command: [sh, -c, "exec sleep 600"]
    parameters: [params/common.yaml]
"""
COMMON = b"# by hand\n/**: {ros__parameters: {rate: 1.0}}\n"
MORE = b"/one: {ros__parameters: {name: x}}\n"


@pytest.mark.parametrize("folder", [b"plain", b"caf\xe9"])
def test_the_files_that_a_configuration_names_are_recorded(folder: bytes, tmp_path: Path) -> None:
    # A name need not be text: ext4 stores bytes, and old archives unpack to Latin-1.
    place = tmp_path / os.fsdecode(folder)
    (place / "params").mkdir(parents=True)
    (place / "params" / "common.yaml").write_bytes(COMMON)
    (place / "more.yaml").write_bytes(MORE)
    config = place / "system.yaml"
    config.write_bytes(CONFIG)
    with replaying(config, tmp_path / "logs") as replay:
        replay.read_all()
    assert replay.process.returncode == 0
    found = attachments(replay.bag)
    assert found["config.yaml"] == CONFIG
    # Each once, in the order in which they were read.
    assert {name: text for name, text in found.items() if name.startswith("parameters/")} == {
        "parameters/0-common.yaml": COMMON,
        "parameters/1-more.yaml": MORE,
    }
    assert json.loads(found["resolved_config.json"])["source"] == str(config)
