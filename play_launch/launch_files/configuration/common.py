"""What several entries have in common, said once."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Iterable

    from play_launch.launch_files.losses import Losses
    from play_launch.launch_files.records import Process

_USUAL: Final = 5.0
"""Seconds that launch gives a process to follow a signal by default."""


def pull_up(containers: list[dict[str, Any]], processes: list[dict[str, Any]]) -> dict[str, Any]:
    """Take what holds for all out of the entries, and return the keys of the top level for it."""
    top: dict[str, Any] = {}
    if environment := _environment([*containers, *processes]):
        top["environment"] = environment
    if kind := _container_type(containers):
        top["composable_node_loading"] = {"container_type": kind}
    return top


def _environment(entries: list[dict[str, Any]]) -> dict[str, str]:
    started = [entry for entry in entries if not entry.get("attach")]
    if len(started) < 2:
        return {}
    first: dict[str, str] = started[0].get("environment", {})
    common = {
        name: value
        for name, value in first.items()
        if all(entry.get("environment", {}).get(name) == value for entry in started)
    }
    for entry in started:
        left = {
            name: value
            for name, value in entry.get("environment", {}).items()
            if name not in common
        }
        if left:
            entry["environment"] = left
        elif common:
            del entry["environment"]
    return common


def _container_type(containers: list[dict[str, Any]]) -> str:
    """Pull up the type that most containers have; a stock container always says that it is one."""
    counted = Counter(entry["container_type"] for entry in containers)
    del counted["stock"]
    kind, count = next(iter(counted.most_common(1)), ("", 0))
    if count < 2:
        return ""
    for entry in containers:
        if entry["container_type"] == kind:
            del entry["container_type"]
    return str(kind)


def stop_limits(processes: Iterable[Process], losses: Losses) -> dict[str, float]:
    """Return the key `stop`: limits hold for all, so the longest of each is taken.

    launch counts both from one signal to the next, as `sigint` and `sigterm` do. A process whose
    limit is not given keeps at least the one it has in launch; where none is given, the
    configuration's own hold.
    """
    found: dict[str, float] = {}
    for key, name in (("sigint", "sigterm_timeout"), ("sigterm", "sigkill_timeout")):
        given = {process.described: getattr(process, name) for process in processes}
        if all(each is None for each in given.values()):
            continue
        found[key] = max(_USUAL if each is None else each for each in given.values())
        for where, own in given.items():
            if own is not None and own != found[key]:
                what = f"its {name} of {own:g} s; the longest, {found[key]:g} s, holds for all"
                losses.note(where, what)
    return found
