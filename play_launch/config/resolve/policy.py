"""Settings that defaults, a container and a node refine one after the other."""

from __future__ import annotations

from enum import Enum, auto
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct
from msgspec.structs import replace

from play_launch.config.model import (
    ContainerConfig,
    ContainerType,
    Isolation,
    OnCrash,
    RestartLimits,
)
from play_launch.config.resources import (
    LIMIT_KEYS,
    NO_LIMIT,
    GroupPolicy,
    Resources,
    Scheduler,
    cpu_text,
)
from play_launch.config.schema import LoadingSection
from play_launch.config.section import validate_mapping
from play_launch.config.sections import CgroupsSection, GroupLimitsSection
from play_launch.config.tree import Mapping

if TYPE_CHECKING:
    from collections.abc import Iterable

    from play_launch.config.schema import ComposableNodeSection, ContainerSection
    from play_launch.config.sections import (
        LimitsSection,
        ResourcesSection,
        RestartSection,
        SchedulerSection,
    )
    from play_launch.config.tree import Cursor

ISOLATED_KEYS: Final = (
    "isolation",
    "memory_domains",
    "core_dumps",
    "consolidate",
    "auto_reload_on_crash",
    "on_crash",
)
"""Keys of containers that only isolated ones read."""
_OF_CONTAINER: Final = LoadingSection.keys.keys() & {*ContainerConfig.__struct_fields__} - {
    "resources",
    "restart",
}
"""Keys of a container that `composable_node_loading` has the defaults of; the two are refined."""
_SHARED_MEMORY: Final = (
    "the kernel accounts the memory of a node that shares it to its container; give it to the "
    "container, or use isolation: process"
)
_CORE_DUMPS: Final = "the key core_dumps of the container says that"


class Policy(Struct, frozen=True):
    """Settings that hold for all containers, for one, and partly for one node."""

    given: dict[str, Any] = {}
    """Keys of a container that are given; `ContainerConfig` has the defaults."""
    on_crash: OnCrash = OnCrash.RELOAD
    restart: RestartLimits = RestartLimits()
    resources: Resources = Resources()
    """Of nodes that are processes of their own; not refined here."""

    @property
    def container_type(self) -> ContainerType:
        kind: ContainerType = self.given.get("container_type", ContainerType.STANDARD)
        return kind

    @property
    def node_process(self) -> ProcessKind:
        """What an isolated node is; where the machine decides that, it may share memory."""
        if self.given.get("isolation") is Isolation.PROCESS:
            return ProcessKind.NODE_WITH_OWN_MEMORY
        return ProcessKind.NODE_IN_SHARED_MEMORY

    def refined(
        self, section: LoadingSection | ContainerSection | ComposableNodeSection, at: Cursor
    ) -> Policy:
        """Return this policy with the settings of `section`, which stands at `at`."""
        automatic, on_crash = section.auto_reload_on_crash, section.on_crash
        if on_crash is None and automatic is not None:
            on_crash = OnCrash.RELOAD if automatic else OnCrash.IGNORE
        elif automatic is not None and automatic is not (on_crash is OnCrash.RELOAD):
            message = f"contradicts on_crash: {on_crash}; leave one of them out"
            at.at_key("auto_reload_on_crash").problem(message)
        given = {key: value for key, value in section.given.items() if key in _OF_CONTAINER}
        return replace(
            self,
            given=self.given | given,
            on_crash=on_crash or self.on_crash,
            restart=refined_restart(self.restart, section.restart, at),
        )


def refined_restart(
    base: RestartLimits, section: RestartSection | None, at: Cursor
) -> RestartLimits:
    """Return `base` with the limits of `section`, which is the key `restart` at `at`."""
    if section is None:
        return base
    given = section.given
    given.pop("backoff", None)
    limits = replace(base, **given, **(section.backoff.given if section.backoff else {}))
    if limits.initial > limits.maximum:
        message = f"initial ({limits.initial:g} s) is longer than maximum ({limits.maximum:g} s)"
        at.at_key("restart").below("backoff").problem(message)
    return limits


def refuse(keys: Iterable[str], why: str, at: Cursor) -> None:
    """Report those of `keys` that stand at `at`."""
    for key in keys:
        if (value := at.value(key)) is not None:
            value.problem(f"{key} {why}")


def refuse_unread(keys: Iterable[str], kind: ContainerType, at: Cursor) -> None:
    """Report those of `keys` that stand at `at`, unless the container is isolated."""
    if not kind.is_isolated:
        why = f"is for container_type isolated and isolated_mt, this container is {kind}"
        refuse(keys, why, at)


class ProcessKind(Enum):
    """Kind of process that requests resources."""

    CONTAINER = auto()
    """Of play-launch's own."""
    PROGRAM = auto()
    """A program other than play-launch's container."""
    NODE_WITH_OWN_MEMORY = auto()
    NODE_IN_SHARED_MEMORY = auto()


_IMPOSSIBLE: Final[dict[ProcessKind, dict[str, str]]] = {
    ProcessKind.CONTAINER: {},
    ProcessKind.PROGRAM: {
        "lock_memory": "a lock on memory does not survive the start of a program; have the program "
        "call mlockall(), which rlimits: {memlock: unlimited} allows"
    },
    ProcessKind.NODE_WITH_OWN_MEMORY: {"rlimits.core": _CORE_DUMPS},
    ProcessKind.NODE_IN_SHARED_MEMORY: {
        "lock_memory": "it shares the memory of its container; give it to the container",
        "oom_score_adj": "the kernel has one for all processes that share memory; give it to the "
        "container",
        "memory_high": _SHARED_MEMORY,
        "memory_max": _SHARED_MEMORY,
        "rlimits.core": _CORE_DUMPS,
        **{
            f"rlimits.{name}": "the limit is about memory or descriptors that it shares with its "
            "container; give it to the container"
            for name in ("as", "data", "memlock", "nofile", "stack")
        },
    },
}
"""Settings that such a process cannot have, with the reason."""


def refined_resources(
    base: Resources, section: ResourcesSection | None, at: Cursor, process: ProcessKind
) -> Resources:
    """Return `base` with the settings of `section`, which is the key `resources` at `at`."""
    if section is None:
        return base
    where = at.at_key("resources")
    if _refuse_impossible(where, process):
        return base
    given = {key: value for key, value in section.given.items() if key not in LIMIT_KEYS}
    if section.scheduler is not None:
        given["scheduler"] = scheduler = _scheduler(section.scheduler, where)
        if scheduler.policy.is_real_time and section.nice is not None:
            where.at_key("nice").problem(f"nothing reads it with the policy {scheduler.policy}")
    if section.rlimits is not None:
        limits = {limit.name: limit for limit in (*base.rlimits, *section.rlimits.given.values())}
        given["rlimits"] = tuple(limits[name] for name in sorted(limits))
    base = replace(_with_limits(base, section), **given)
    _refuse_contradictions(base, where)
    return base


def refuse_inherited(resources: Resources, at: Cursor, process: ProcessKind) -> None:
    """Report what the defaults give a process that cannot have it; it stands at `at`."""
    limits = {f"rlimits.{name}" for name in resources.limit_names}
    own = at.value("resources")
    for name, why in _IMPOSSIBLE[process].items():
        if name in resources.described().keys() | limits and _value(own, name) is None:
            at.problem(f"{name} of composable_node_loading cannot hold for it: {why}")


def _refuse_impossible(at: Cursor, process: ProcessKind) -> bool:
    """Report what stands there that such a process cannot have; return whether there was any."""
    refused = False
    for name, why in _IMPOSSIBLE[process].items():
        value = _value(at, name)
        if value is not None:
            value.problem(f"{name.rpartition('.')[2]} cannot be given here: {why}")
            refused = True
    return refused


def _value(at: Cursor | None, path: str) -> Cursor | None:
    for key in path.split("."):
        at = at and at.value(key)
    return at


def _refuse_contradictions(resources: Resources, at: Cursor) -> None:
    """Report settings that the kernel accepts or refuses without any effect."""
    group, cpus = resources.group, set(resources.cpu_affinity)
    if cpus and group.cpuset and not cpus.intersection(group.cpuset):
        at.at_key("cpu_affinity").problem(
            f"none of these CPUs is in its cpuset, {cpu_text(group.cpuset)}; give one of the two"
        )
    high, most = group.memory_high, group.memory_max
    if high is not None and most is not None and most < high < NO_LIMIT:
        at.at_key("memory_high").problem("is never reached: it is above memory_max")


def _with_limits(base: Resources, section: LimitsSection) -> Resources:
    given = section.given
    if "cpuset_cpus" in given:
        given["cpuset"] = given["cpuset_cpus"]
    limits = {key: value for key, value in given.items() if key in LIMIT_KEYS}
    return replace(base, group=replace(base.group, **limits)) if limits else base


def _scheduler(section: SchedulerSection, at: Cursor) -> Scheduler:
    where = at.at_key("scheduler")
    if section.policy.is_real_time and section.priority is None:
        where.problem(f'the key "priority", 1 to 99, is missing, which goes with {section.policy}')
    elif section.priority is not None and not section.policy.is_real_time:
        where.at_key("priority").problem(f"only for fifo and rr, the policy is {section.policy}")
    return Scheduler(section.policy, section.priority or 0)


class GroupRules:
    """`composable_node_loading.cgroups`: which control groups there are, and limits of nodes."""

    def __init__(self, section: CgroupsSection | None, at: Cursor | None) -> None:
        section = section or CgroupsSection()
        self.policy = GroupPolicy(
            enabled=section.enabled,
            base_path=Path(section.base_path) if section.base_path else None,
            required=bool(section.required),
        )
        self._defaults: list[tuple[GroupLimitsSection, Cursor]] = []
        self._of_nodes: dict[str, tuple[GroupLimitsSection, Cursor]] = {}
        self._unused: dict[str, Cursor] = {}
        if at is None:
            return
        if section.defaults is not None:
            self._defaults.append((section.defaults, at.at_key("defaults")))
        per_node = at.value("per_node")
        if per_node is not None and not isinstance(per_node.node, Mapping):
            per_node.expected("a mapping of names of nodes to their limits")
        for entry, value in per_node.entries() if per_node is not None else ():
            limits = validate_mapping(GroupLimitsSection, value)
            if limits is not None:
                self._of_nodes[entry.key] = limits, value
                self._unused[entry.key] = value
        for limits, where in (*self._defaults, *self._of_nodes.values()):
            if limits.cpuset is not None and limits.cpuset_cpus is not None:
                alias = where.at_key("cpuset_cpus")
                alias.problem("is another name of cpuset, which is given, too")

    def defaults(self, base: Resources, process: ProcessKind) -> Resources:
        return _with_groups(base, self._defaults, process)

    def of_node(self, base: Resources, names: Iterable[str], process: ProcessKind) -> Resources:
        for name in names:
            self._unused.pop(name, None)
        given = [self._of_nodes[name] for name in names if name in self._of_nodes]
        return _with_groups(base, given, process)

    def refuse_unused(self) -> None:
        for at in self._unused.values():
            at.problem(
                "no composable node of an isolated container is called so; give limits of a "
                "container or process under its resources"
            )


def _with_groups(
    base: Resources, given: Iterable[tuple[GroupLimitsSection, Cursor]], process: ProcessKind
) -> Resources:
    for section, at in given:
        if not _refuse_impossible(at, process):
            base = _with_limits(base, section)
    return base
