"""Containers that are not play-launch's own: `package`, `executable`, `arguments`, `attach`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from play_launch.config.model import ContainerType

if TYPE_CHECKING:
    from collections.abc import Iterable

    from play_launch.config.report import Report
    from play_launch.config.schema import ContainerSection
    from play_launch.config.yaml_tree import Mapping

STOCK_PACKAGE: Final = "rclcpp_components"
STOCK_EXECUTABLE: Final = "component_container"
_KEYS: Final = ("package", "executable", "arguments", "attach")
_OUR_KEYS: Final = ("probe_timeout",)
"""Keys that say something for play-launch's own containers only."""
_FOR_STARTING: Final = (
    "package",
    "executable",
    "arguments",
    "environment",
    "log_level",
    "ros_arguments",
)
"""Keys that say how a container is started; one that runs already reads none of them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StockProgram:
    """What a stock container is; all empty for one of play-launch's own."""

    package: str = ""
    executable: str = ""
    arguments: tuple[str, ...] = ()
    attach: bool = False


def resolve_stock(
    section: ContainerSection, kind: ContainerType, owner: Mapping, path: str, report: Report
) -> StockProgram:
    """Return what `section` says, which stands in `owner`; report keys that nothing would read."""
    if kind is not ContainerType.STOCK:
        why = f"is for container_type stock, this container is {kind}"
        _refuse(_KEYS, why, owner, path, report)
        return StockProgram()
    why = "is not for container_type stock, whose libraries are not probed"
    _refuse(_OUR_KEYS, why, owner, path, report)
    if section.attach:
        why = "is for a container that is started here, not for attach: true"
        _refuse(_FOR_STARTING, why, owner, path, report)
        return StockProgram(attach=True)
    return StockProgram(
        package=section.package or STOCK_PACKAGE,
        executable=section.executable or STOCK_EXECUTABLE,
        arguments=tuple(section.arguments or ()),
    )


def _refuse(keys: Iterable[str], why: str, owner: Mapping, path: str, report: Report) -> None:
    for key in keys:
        entry = owner.entry(key)
        if entry is not None:
            report.add(entry.value.place, f"{path}.{key}", f"{key} {why}")
