"""`composable_node_loading.cgroups`: which control groups there are, and limits of nodes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from play_launch.config.group_limits import GroupPolicy
from play_launch.config.resolve.resources import refined_limits, refuse
from play_launch.config.resource_schema import GroupLimitsSection
from play_launch.config.validation import validate_mapping
from play_launch.config.yaml.tree import Mapping

if TYPE_CHECKING:
    from play_launch.config.resolve.resources import Process
    from play_launch.config.resource_schema import CgroupsSection
    from play_launch.config.resources import Resources
    from play_launch.config.yaml.tree import At

_DEFAULTS: Final = "defaults"
_PER_NODE: Final = "per_node"


class GroupRules:
    """The section `cgroups`; `at` is its location, None without one."""

    def __init__(self, section: CgroupsSection | None, at: At | None) -> None:
        """Read the section and report what is wrong with it."""
        self.policy = GroupPolicy()
        self._at = at
        self._defaults: GroupLimitsSection | None = None
        self._of_nodes: dict[str, tuple[GroupLimitsSection, At]] = {}
        self._used: set[str] = set()
        if section is None or at is None:
            return
        self.policy = GroupPolicy(
            enabled=section.enabled,
            base_path=Path(section.base_path) if section.base_path else None,
            required=bool(section.required),
        )
        self._defaults = section.defaults
        if section.defaults is not None:
            _refuse_two_names(section.defaults, at.blame(_DEFAULTS))
        self._read_nodes(at.value(_PER_NODE))

    def _read_nodes(self, at: At | None) -> None:
        if at is None:
            return
        if not isinstance(at.node, Mapping):
            at.expected("a mapping of names of nodes to their limits")
            return
        for entry, value in at.entries():
            section = validate_mapping(GroupLimitsSection, value)
            if section is not None:
                _refuse_two_names(section, value)
                self._of_nodes[entry.key] = section, value

    def defaults(self, base: Resources, process: Process) -> Resources:
        """Return what nodes have unless something else is said, which is `base` without it."""
        if self._at is None or self._defaults is None:
            return base
        return _refined(base, self._defaults, self._at.blame(_DEFAULTS), process)

    def of_node(
        self, base: Resources, name: str, full_name: str | None, process: Process
    ) -> Resources:
        """Return `base` with what is said of a node by its name or its full name."""
        for each in (name, full_name):
            if each and each in self._of_nodes:
                self._used.add(each)
                section, at = self._of_nodes[each]
                base = _refined(base, section, at, process)
        return base

    def refuse_unused(self) -> None:
        """Report names that no isolated node has."""
        for name, (_, at) in self._of_nodes.items():
            if name not in self._used:
                at.problem(
                    "no composable node of an isolated container is called so; give limits of a "
                    "container or process under its resources"
                )


def _refined(base: Resources, section: GroupLimitsSection, at: At, process: Process) -> Resources:
    if refuse(at, process):
        return base
    return replace(base, group=refined_limits(base.group, section))


def _refuse_two_names(section: GroupLimitsSection, at: At) -> None:
    if section.cpuset is not None and section.cpuset_cpus is not None:
        at.blame("cpuset_cpus").problem("is another name of cpuset, which is given, too")
