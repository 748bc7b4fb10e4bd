"""Restart limits from a `restart` mapping over those it refines."""

from __future__ import annotations

from typing import TYPE_CHECKING

from play_launch.core.restart import RestartLimits

if TYPE_CHECKING:
    from play_launch.config.report import Report
    from play_launch.config.schema import RestartSection
    from play_launch.config.yaml_tree import Mapping


def merge_restart(
    base: RestartLimits, section: RestartSection | None, owner: Mapping, path: str, report: Report
) -> RestartLimits:
    """Return `base` with what `section` says instead; `owner` is the mapping it stands in."""
    if section is None:
        return base
    initial = section.backoff.initial if section.backoff is not None else None
    maximum = section.backoff.maximum if section.backoff is not None else None
    merged = RestartLimits(
        max_restarts=base.max_restarts if section.max_restarts is None else section.max_restarts,
        within=base.within if section.within is None else section.within,
        initial=base.initial if initial is None else initial,
        maximum=base.maximum if maximum is None else maximum,
    )
    if merged.initial > merged.maximum:
        place = (owner.value("restart") or owner).place
        report.add(
            place,
            f"{path}.restart.backoff",
            f"initial ({merged.initial:g} s) is longer than maximum ({merged.maximum:g} s)",
        )
    return merged
