"""Reads `system_model.yaml`, what the program play_launch (Rust) has resolved a launch file to.

Its fields are those of `NodeInstance` and its neighbours in the crate `model` of the repository
ros-launch-manifest; `docs/design/system-model.md` of play_launch describes them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from play_launch.config.model import Autostart
from play_launch.launch_files.importing.fields import Fields, read_unit
from play_launch.launch_files.records import Description, ProgramKind

if TYPE_CHECKING:
    from collections.abc import Mapping

    from play_launch.launch_files.records import Losses, Unit

NEWEST_VERSION: Final = 1
_WIRING: Final = ("topics", "services", "actions")
"""What is connected follows from the nodes; it is written down, not done."""
_CONTAINER_PROGRAM: Final = "component_container"
_RENAMED: Final = {
    "container": "target_container_name",
    "exec": "executable",
    "pkg": "package",
    "raw_cmd": "cmd",
}
"""Fields that `record.json` has by other names."""
_AUTOSTART: Final = {"configure": Autostart.CONFIGURE, "active": Autostart.ACTIVATE}


def is_system_model(values: Any) -> bool:
    """Whether the values of a file are such a model."""
    return isinstance(values, dict) and isinstance(values.get("structure"), dict)


def read_system_model(values: Mapping[str, Any], losses: Losses) -> Description:
    fields = Fields(values, "(top level)", losses)
    meta = Fields(fields.take("meta") or {}, "meta", losses)
    version = meta.take("version")
    if isinstance(version, int) and version > NEWEST_VERSION:
        losses.lost("meta", f"version {version} is newer than {NEWEST_VERSION}, which is read here")
    for text in meta.get("diagnostics", list[str]) or ():
        losses.note("meta", f"the model says: {text}")
    structure = Fields(fields.take("structure"), "structure", losses)
    scopes = _mapping(structure.take("scopes"))
    nodes = _mapping(structure.take("nodes"))
    for kind in _WIRING:
        structure.take(kind)
    structure.refuse_rest()
    elsewhere = _read_execution(fields.take("execution"), losses)
    fields.refuse_rest()
    targets = _targets(nodes)
    system = Description()
    for key, record in nodes.items():
        if key in elsewhere:
            losses.lost(key, f"runs on {elsewhere[key]}, not on this machine")
        else:
            system.units.append(_node(key, record, targets, scopes, losses))
    return system


def _mapping(values: Any) -> dict[str, Any]:
    return values if isinstance(values, dict) else {}


def _targets(nodes: Mapping[str, Any]) -> set[str]:
    """Return the names that composable nodes give as their container."""
    return {
        str(record["container"])
        for record in nodes.values()
        if isinstance(record, dict) and record.get("container")
    }


def _read_execution(values: Any, losses: Losses) -> dict[str, str]:
    """Report what is not done here; return the nodes that are not for this machine."""
    execution = Fields(values or {}, "execution", losses)
    elsewhere: dict[str, str] = {}
    for key, record in _mapping(execution.take("deploy")).items():
        deploy = Fields(record, f"execution.deploy {key}", losses)
        target = deploy.text("target")
        if target not in ("", "linux"):
            elsewhere[key] = target
        deploy.refuse_rest()
    execution.refuse_rest()
    return elsewhere


def _node(
    key: str, record: Any, targets: set[str], scopes: Mapping[str, Any], losses: Losses
) -> Unit:
    values = {_RENAMED.get(name, name): value for name, value in _mapping(record).items()}
    is_composable = bool(values.get("plugin"))
    is_container = bool(values.pop("is_container", False)) or (
        # As older models have it.
        key in targets and str(values.get("executable")).startswith(_CONTAINER_PROGRAM)
    )
    namespace, _, last = key.rpartition("/")
    # A process whose name is not declared is called after its executable, with a number.
    name = values.get("node_name") or (last if is_composable or is_container else "")
    values |= {"node_name": str(name).rpartition("/")[2], "namespace": namespace}
    fields = Fields(values if isinstance(record, dict) else record, key, losses)
    is_lifecycle = bool(fields.get("lifecycle", bool))
    autostart = _AUTOSTART.get(fields.text("lifecycle_autostart"))
    scope = fields.text("scope")
    if criticality := fields.text("criticality"):
        losses.lost(key, f"its criticality {criticality}: nodes run unscheduled here")
    kind = ProgramKind.CONTAINER if is_container else ProgramKind.NODE
    unit = read_unit(fields, None if is_composable else kind, scope if scope in scopes else "")
    unit.is_lifecycle, unit.autostart = is_lifecycle, autostart if is_lifecycle else None
    fields.refuse_rest()
    return unit
