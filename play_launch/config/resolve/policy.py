"""Settings that defaults, a container and a node refine one after the other."""

from __future__ import annotations

from enum import Enum, auto
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct, field
from msgspec.structs import replace

from play_launch.config.model import ContainerType, Isolation, MemoryDomains, OnCrash, RestartLimits
from play_launch.config.resource_schema import GroupLimitsSection
from play_launch.config.resources import (
    LIMIT_KEYS,
    NO_LIMIT,
    GroupPolicy,
    Resources,
    Scheduler,
    cpu_text,
)
from play_launch.config.section import validate_mapping
from play_launch.config.tree import Mapping

if TYPE_CHECKING:
    from collections.abc import Iterable

    from play_launch.config.resource_schema import (
        CgroupsSection,
        LimitsSection,
        ResourcesSection,
        SchedulerSection,
    )
    from play_launch.config.resources import GroupLimits
    from play_launch.config.schema import (
        ComposableNodeSection,
        ContainerSection,
        LoadingSection,
        RestartSection,
    )
    from play_launch.config.section import Section
    from play_launch.config.tree import At


ISOLATED_KEYS: Final = (
    "isolation",
    "memory_domains",
    "core_dumps",
    "auto_reload_on_crash",
    "on_crash",
)
"""Keys of containers that say something for isolated ones only."""


class Policy(Struct, frozen=True):
    """What may be said for all containers, for one, and partly for one node; in seconds."""

    container_type: ContainerType = ContainerType.STANDARD
    thread_num: int | None = None
    isolation: Isolation = Isolation.AUTO
    memory_domains: MemoryDomains = MemoryDomains.OFF
    core_dumps: bool = False
    loading_timeout: float = 10.0
    probe_timeout: float = 60.0
    on_crash: OnCrash = OnCrash.RELOAD
    restart: RestartLimits = field(default_factory=RestartLimits)
    resources: Resources = Resources()
    """Of nodes that are processes of their own; not refined here."""

    def refined(
        self, section: LoadingSection | ContainerSection | ComposableNodeSection, at: At
    ) -> Policy:
        """Return this policy with what `section` says instead, which stands at `at`."""
        return replace(
            self,
            **_given(section, _PLAIN),
            on_crash=_refined_on_crash(self.on_crash, section, at),
            restart=refined_restart(self.restart, section.restart, at),
        )


_PLAIN: Final = set(Policy.__struct_fields__) - {"on_crash", "restart", "resources"}


def refined_restart(base: RestartLimits, section: RestartSection | None, at: At) -> RestartLimits:
    """Return `base` with what `section` says instead, which is the key `restart` at `at`."""
    if section is None:
        return base
    given = _given(section, {"max_restarts", "within"})
    pauses = {} if section.backoff is None else section.backoff.given
    limits = replace(base, **given, **pauses)
    if limits.initial > limits.maximum:
        where = at.blame("restart")
        message = f"initial ({limits.initial:g} s) is longer than maximum ({limits.maximum:g} s)"
        where.below("backoff").problem(message)
    return limits


def refuse_unread(keys: Iterable[str], kind: ContainerType, at: At) -> None:
    """Report those of `keys` that stand there, if the container is none that reads them."""
    if not kind.is_isolated:
        why = f"is for container_type isolated and isolated_mt, this container is {kind}"
        refuse(keys, why, at)


def refuse(keys: Iterable[str], why: str, at: At) -> None:
    """Report those of `keys` that stand there."""
    for key in keys:
        value = at.value(key)
        if value is not None:
            value.problem(f"{key} {why}")


def _refined_on_crash(
    base: OnCrash, section: LoadingSection | ContainerSection | ComposableNodeSection, at: At
) -> OnCrash:
    automatic, on_crash = section.auto_reload_on_crash, section.on_crash
    if on_crash is None:
        if automatic is None:
            return base
        return OnCrash.RELOAD if automatic else OnCrash.IGNORE
    if automatic is not None and automatic is not (on_crash is OnCrash.RELOAD):
        message = f"contradicts on_crash: {on_crash}; leave one of them out"
        at.blame("auto_reload_on_crash").problem(message)
    return on_crash


def _given(section: Section, names: set[str]) -> dict[str, Any]:
    return {name: value for name, value in section.given.items() if name in names}


KEY: Final = "resources"
_RLIMITS: Final = "rlimits"
_SHARED_LIMIT: Final = "the limit is about memory or descriptors that it shares with its container"
_EXEC: Final = (
    "a lock on memory does not survive the start of a program; have the program call mlockall(), "
    "which rlimits: {memlock: unlimited} allows"
)
_SHARED_MEMORY: Final = (
    "the kernel accounts the memory of a node that shares it to its container; give it to the "
    "container, or use isolation: process"
)
_CORE_DUMPS: Final = "the key core_dumps of the container says that"


class Process(Enum):
    """What kind of process asks."""

    CONTAINER = auto()
    """Of play-launch's own."""
    PROGRAM = auto()
    """A program other than play-launch's container."""
    NODE_WITH_OWN_MEMORY = auto()
    NODE_IN_SHARED_MEMORY = auto()


_IMPOSSIBLE: Final[dict[Process, dict[str, str]]] = {
    Process.CONTAINER: {},
    Process.PROGRAM: {"lock_memory": _EXEC},
    Process.NODE_WITH_OWN_MEMORY: {"rlimits.core": _CORE_DUMPS},
    Process.NODE_IN_SHARED_MEMORY: {
        "lock_memory": "it shares the memory of its container; give it to the container",
        "oom_score_adj": "the kernel has one for all processes that share memory; give it to the "
        "container",
        "memory_high": _SHARED_MEMORY,
        "memory_max": _SHARED_MEMORY,
        "rlimits.core": _CORE_DUMPS,
        **{
            f"{_RLIMITS}.{name}": f"{_SHARED_LIMIT}; give it to the container"
            for name in ("as", "data", "memlock", "nofile", "stack")
        },
    },
}
"""What such a process cannot have, with the reason."""


def node_process(isolation: Isolation) -> Process:
    """What an isolated node is; where that is up to the machine, it may share memory."""
    own = isolation is Isolation.PROCESS
    return Process.NODE_WITH_OWN_MEMORY if own else Process.NODE_IN_SHARED_MEMORY


def refined_resources(
    base: Resources, section: ResourcesSection | None, at: At, process: Process
) -> Resources:
    """Return `base` with what `section` says instead, which is the key `resources` at `at`."""
    if section is not None:
        where = at.blame(KEY)
        if refuse_impossible(where, process):
            return base
        base = replace(base, **_given_resources(base, section, where))
        _refuse_contradictions(base, where)
    return base


def _refuse_contradictions(resources: Resources, at: At) -> None:
    """Report what the kernel takes, or refuses, without anything of it ever holding."""
    group, cpus = resources.group, set(resources.cpu_affinity)
    if cpus and group.cpuset and not cpus.intersection(group.cpuset):
        at.blame("cpu_affinity").problem(
            f"none of these CPUs is in its cpuset, {cpu_text(group.cpuset)}; give one of the two"
        )
    high, most = group.memory_high, group.memory_max
    if high is not None and most is not None and most < high < NO_LIMIT:
        at.blame("memory_high").problem("is never reached: it is above memory_max")


def refuse_inherited(resources: Resources, at: At, process: Process) -> None:
    """Report what the defaults give a process that cannot have it; it stands at `at`."""
    limits = {f"{_RLIMITS}.{limit.name}" for limit in resources.rlimits}
    inherited = (resources.described().keys() | limits) - _keys(at.value(KEY))
    for name, why in _IMPOSSIBLE[process].items():
        if name in inherited:
            at.problem(f"{name} of composable_node_loading cannot hold for it: {why}")


def refuse_impossible(at: At, process: Process) -> bool:
    """Report what stands there that such a process cannot have; whether there was any."""
    limits = at.value(_RLIMITS)
    refused = False
    for name, why in _IMPOSSIBLE[process].items():
        key, _, limit = name.partition(".")
        value = at.value(key) if not limit else limits and limits.value(limit)
        if value is not None:
            value.problem(f"{limit or key} cannot be given here: {why}")
            refused = True
    return refused


def _keys(at: At | None) -> set[str]:
    """Name what stands there."""
    if at is None:
        return set()
    limits = at.value(_RLIMITS)
    names = {entry.key for entry, _ in at.entries()}
    if limits is not None:
        names |= {f"{_RLIMITS}.{entry.key}" for entry, _ in limits.entries()}
    return names


def _given_resources(base: Resources, section: ResourcesSection, at: At) -> dict[str, Any]:
    given = {key: value for key, value in section.given.items() if key not in LIMIT_KEYS}
    given["group"] = refined_limits(base.group, section)
    if section.scheduler is not None:
        given["scheduler"] = scheduler = _scheduler(section.scheduler, at)
        if scheduler.policy.is_real_time and section.nice is not None:
            at.blame("nice").problem(f"nothing reads it with the policy {scheduler.policy}")
    if section.rlimits is not None:
        limits = {limit.name: limit for limit in (*base.rlimits, *section.rlimits.given.values())}
        given[_RLIMITS] = tuple(limits[name] for name in sorted(limits))
    return given


def refined_limits(base: GroupLimits, section: LimitsSection) -> GroupLimits:
    """Return `base` with what `section` says instead."""
    given = section.given
    if "cpuset_cpus" in given:
        given["cpuset"] = given["cpuset_cpus"]
    limits = {key: value for key, value in given.items() if key in LIMIT_KEYS}
    return replace(base, **limits) if limits else base


def _scheduler(section: SchedulerSection, at: At) -> Scheduler:
    where = at.blame("scheduler")
    if section.policy.is_real_time and section.priority is None:
        where.problem(f'the key "priority", 1 to 99, is missing, which goes with {section.policy}')
    elif section.priority is not None and not section.policy.is_real_time:
        where.blame("priority").problem(f"only for fifo and rr, the policy is {section.policy}")
    return Scheduler(section.policy, section.priority or 0)


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
    if refuse_impossible(at, process):
        return base
    return replace(base, group=refined_limits(base.group, section))


def _refuse_two_names(section: GroupLimitsSection, at: At) -> None:
    if section.cpuset is not None and section.cpuset_cpus is not None:
        at.blame("cpuset_cpus").problem("is another name of cpuset, which is given, too")
