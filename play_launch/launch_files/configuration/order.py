"""What starts later: conditions of records as `depends_on` and `start_delay`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from play_launch.launch_files.records import Event, Process

if TYPE_CHECKING:
    from collections.abc import Mapping

    from play_launch.launch_files.losses import Losses
    from play_launch.launch_files.records import StartCondition, Unit

_ACTIVE: Final = "active"


def add_order(
    entry: dict[str, Any],
    unit: Unit,
    units: Mapping[str, Unit],
    names: Mapping[str, str],
    losses: Losses,
) -> None:
    """Add `depends_on` and `start_delay` to the entry of a unit.

    `units` are all by id, `names` what the configuration calls those that it has.
    """
    delay = 0.0
    dependencies: list[Any] = []
    for condition in unit.start:
        if condition.event is Event.DELAY:
            delay += condition.seconds
            continue
        target = units.get(condition.unit)
        name = names.get(condition.unit)
        if target is None or name is None:
            losses.lost(unit.described, f"waits for something that is not there: {condition.event}")
            continue
        dependency = _dependency(condition, target, name)
        if isinstance(dependency, str):
            losses.lost(unit.described, f"does not wait: {dependency}")
        elif dependency not in dependencies:
            dependencies.append(dependency)
    if dependencies:
        entry["depends_on"] = dependencies
    if delay:
        entry["start_delay"] = delay


def _dependency(condition: StartCondition, target: Unit, name: str) -> dict[str, Any] | str:
    """Return the entry of `depends_on`, or why there is none."""
    is_process = isinstance(target, Process)
    match condition.event:
        case Event.STARTED if is_process:
            return {"name": name, "condition": "started"}
        case Event.EXITED if is_process:
            if isinstance(target, Process) and target.respawn:
                return f"{name} is started again whenever it exits"
            # The launch file does not ask for an exit status.
            return {"name": name, "condition": "exited", "on_timeout": "start"}
        case Event.LOADED:
            return {"name": name, "condition": "loaded"}
        case Event.STATE if condition.state == _ACTIVE:
            return {"name": name, "condition": "active"}
        case Event.OUTPUT if is_process:
            return {"name": name, "log": condition.pattern}
    return f"{condition.event} {condition.state} of {name} cannot be said".replace("  ", " ")
