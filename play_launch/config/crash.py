"""What becomes of a node that crashes alone: `on_crash`, `auto_reload_on_crash`, `restart`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from play_launch.config.restart import merge_restart
from play_launch.core.crash import OnCrash

if TYPE_CHECKING:
    from collections.abc import Iterable

    from play_launch.config.model import ContainerType
    from play_launch.config.report import Report
    from play_launch.config.schema import ComposableNodeSection, ContainerSection, LoadingSection
    from play_launch.config.yaml_tree import Mapping
    from play_launch.core.restart import RestartLimits

ISOLATED_KEYS: Final = ("isolation", "core_dumps", "auto_reload_on_crash", "on_crash")
"""Keys of containers that say something for isolated ones only."""
_NODE_KEYS: Final = ("auto_reload_on_crash", "on_crash", "restart")


@dataclass(frozen=True, slots=True)
class CrashRules:
    """What holds for the nodes of one container that say nothing else.

    `container_type` is None where the container itself could not be read.
    """

    container_type: ContainerType | None
    on_crash: OnCrash
    restart: RestartLimits


def merge_on_crash(
    base: OnCrash,
    section: LoadingSection | ContainerSection | ComposableNodeSection | None,
    owner: Mapping,
    path: str,
    report: Report,
) -> OnCrash:
    """Return what `section` says, which stands in `owner`; `base` where it says nothing."""
    if section is None:
        return base
    automatic, on_crash = section.auto_reload_on_crash, section.on_crash
    if on_crash is None:
        if automatic is None:
            return base
        return OnCrash.RELOAD if automatic else OnCrash.IGNORE
    if automatic is not None and automatic is not (on_crash is OnCrash.RELOAD):
        entry = owner.entry("auto_reload_on_crash")
        place = owner.place if entry is None else entry.value.place
        message = f"contradicts on_crash: {on_crash}; leave one of them out"
        report.add(place, f"{path}.auto_reload_on_crash", message)
    return on_crash


def merge_node(
    rules: CrashRules, section: ComposableNodeSection, owner: Mapping, path: str, report: Report
) -> tuple[OnCrash, RestartLimits]:
    """Return what holds for the node that `section` describes."""
    if rules.container_type is not None:
        refuse_unread(_NODE_KEYS, rules.container_type, owner, path, report)
    on_crash = merge_on_crash(rules.on_crash, section, owner, path, report)
    return on_crash, merge_restart(rules.restart, section.restart, owner, path, report)


def refuse_unread(
    keys: Iterable[str], kind: ContainerType, owner: Mapping, path: str, report: Report
) -> None:
    """Report those of `keys` that `owner` has, if the container is none that reads them."""
    if kind.is_isolated:
        return
    for key in keys:
        entry = owner.entry(key)
        if entry is not None:
            message = f"{key} is for container_type isolated and isolated_mt"
            where = f"{path}.{key}"
            report.add(entry.value.place, where, f"{message}, this container is {kind}")
