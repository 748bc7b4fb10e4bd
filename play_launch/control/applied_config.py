"""Puts a configuration that is applied to a running system into its recording."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from play_launch.container.cdr.text import text_bytes
from play_launch.recording.resolved_form import resolved_form

if TYPE_CHECKING:
    from play_launch.config.model import ReplayConfig
    from play_launch.recording.topic_requests import TopicRequests

FOLDER: Final = "applied"


def as_started(config: ReplayConfig, target: ReplayConfig, *, keeps_duration: bool) -> ReplayConfig:
    """Put into ``target`` what the command line of the session said, as it did into ``config``."""
    if keeps_duration:
        target = replace(target, duration=config.duration)
    folders = config.log_dir, target.log_dir
    if None not in folders and len({str(each and each.absolute()) for each in folders}) == 1:
        target = replace(target, log_dir=config.log_dir)  # one of them is a relative path
    return target


def attach_applied(recording: TopicRequests, config: ReplayConfig, number: int) -> None:
    """Attach it as ``applied/<number>/...``: as it was given, its files, and resolved."""
    place = f"{FOLDER}/{number}"
    yaml = "application/yaml"
    recording.attach(f"{place}/config{config.source.suffix or '.yaml'}", yaml, config.text)
    for kind, files in (
        ("includes", config.included_files),
        ("parameters", config.parameter_files),
    ):
        for index, file in enumerate(files):
            recording.attach(f"{place}/{kind}/{index}-{file.path.name}", yaml, file.text)
    resolved = json.dumps(resolved_form(config), ensure_ascii=False)
    recording.attach(f"{place}/resolved_config.json", "application/json", text_bytes(resolved))
