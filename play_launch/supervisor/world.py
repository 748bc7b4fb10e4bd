"""The world: what is wanted, and what is; everything that is decided upon, and nothing else.

Times are seconds of the event loop's clock. The units are immutable and replaced as a whole;
`World.before` keeps them as they were, for `play_launch.supervisor.difference`.
"""

from __future__ import annotations

from enum import StrEnum, auto
from heapq import heappop, heappush
from typing import TYPE_CHECKING, Final, NamedTuple, TypeAlias, TypeVar

from msgspec import Struct
from msgspec.structs import replace

from play_launch.config.model import ComposableNodeConfig, ContainerConfig, ContainerType
from play_launch.config.node_key import NodeKey
from play_launch.supervisor.events import ContainerState, ManagedState, NodeState
from play_launch.supervisor.outcome import BLOCKED_AFTER, Cause, Outcome, RestartHistory

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.config.dependency import Condition
    from play_launch.config.model import ManagedConfig, ProcessConfig, ReplayConfig
    from play_launch.supervisor.change import Change
    from play_launch.supervisor.inputs import ProbeResult


class Stage(StrEnum):
    """Stage of a node's quarantine."""

    TRUSTED = auto()
    """It is loaded whenever the container is ready."""
    PROBING = auto()
    """Its library is being loaded, or going to be loaded, in a scratch process."""
    CLEARED = auto()
    """Its library can be loaded; the node waits for its turn, or is being loaded."""
    CONDEMNED = auto()
    """Its library cannot be loaded; it is probed again when the container starts anew."""
    REFUSED = auto()
    """It took the container down too often."""


class Phase(StrEnum):
    """Phase of a container or an ordinary process."""

    STOPPED = "stopped"
    QUEUED = "queued"
    """To be started, as soon as its conditions are met and its last process is cleaned up."""
    SPAWNING = "spawning"
    """Its start is under way; it has no pid yet."""
    STARTING = "starting"
    """Its process runs; a container has not said hello."""
    RUNNING = "running"
    KILLING = "killing"
    """It was sent SIGKILL, and its exit is awaited."""
    STOPPING = "stopping"
    BACKOFF = "backoff"
    """It exited, and is started again after a delay."""
    GAVE_UP = "gave up"


STATE_OF_PHASE: Final = {
    phase: ContainerState.STARTING
    if phase in {Phase.QUEUED, Phase.SPAWNING, Phase.STARTING}
    else ContainerState(phase.value)
    for phase in Phase
}
"""The phase as events have it."""

INACTIVE: Final = frozenset({Phase.STOPPED, Phase.GAVE_UP})


class Wait(Struct, frozen=True):
    """A start or load that waits for its conditions."""

    since: float
    met_since: float | None = None
    """When all conditions were met or waived; the start delay runs from then."""
    text: str = ""
    """What it waits for, as reported."""
    report_due: float = 0.0
    """When it is reported again that it waits."""
    next_at: float | None = None
    """When time alone may change the conditions."""


class Exit(Struct, frozen=True):
    """How a process exited; ``signal`` is 0 where none ended it."""

    text: str
    code: int = 0
    signal: int = 0
    is_lost: bool = False
    """Whether its exit status is unknown."""

    @property
    def is_ok(self) -> bool:
        return self.code == 0 and self.signal == 0 and not self.is_lost


class Hello(Struct, frozen=True):
    """What a container reported of itself when it was ready."""

    mechanism: str = ""
    """How its nodes are isolated: ``shared_memory``, ``process``; empty where they are not."""
    description: str = ""


class _Unit(Struct, frozen=True, kw_only=True):
    reason: str = ""
    outcome: Outcome = Outcome()
    """Of the phase or state, as is the reason."""
    is_requested: bool
    """Whether a start or load is requested that has not begun."""
    attempt: int = 0
    """Number of the latest start or load, unique in the session; 0 before the first."""
    pid: int = 0
    start_time: int = 0
    restarts: RestartHistory = RestartHistory()
    wait: Wait | None = None
    released_at: float | None = None
    """When it was started for the first time; automatic restarts wait for no conditions."""
    is_removed: bool = False
    """Whether it is no longer in the configuration, and is forgotten when it has ended."""


class Process(_Unit, frozen=True, kw_only=True):
    """A container or an ordinary process of the configuration."""

    config: ContainerConfig | ProcessConfig
    phase: Phase = Phase.STOPPED
    is_requested: bool = True
    is_present: bool = False
    """Whether something of its latest process is left: the process, its children, its output."""
    is_stuck: bool = False
    """Whether its process does not end, not even by SIGKILL."""
    argv: tuple[str, ...] = ()
    is_started: bool = False
    """Whether its latest start has led to a process; that of an attached container has no pid."""
    exit: Exit | None = None
    """Of the latest process."""
    exit_cause: Cause = Cause.NONE
    """Of that; the outcome may be of what follows already."""
    stopped: bool = False
    """Whether the stop of its process has begun."""
    began_at: float = 0.0
    """When it started; of a container, when it said hello."""
    due: float | None = None
    """When time ends the phase: hello overdue, SIGKILL without effect, restart due."""
    hello: Hello | None = None
    """Of a container that is ready."""
    killed_because: str = ""
    is_fatal: bool = False
    """Whether it is not restarted after this death."""
    blames_loads: bool = True
    """Whether a death of this container may have been caused by a node that was being loaded."""
    lost_locks: bool = False
    """Whether a node was killed while it may have held a lock, which then stays locked."""
    is_leaking: bool = False
    """Whether cleaning up after a dead node failed in this process."""
    request_reason: str = ""
    """Why it was requested to stop or to be replaced."""
    next_config: ContainerConfig | ProcessConfig | None = None
    """The configuration that its next process gets."""

    @property
    def key(self) -> str:
        return self.config.full_name

    name = member = key

    @property
    def times(self) -> tuple[float, ...]:
        return _times(self.wait, self.due)

    @property
    def is_at_rest(self) -> bool:
        """Whether it does not run, nothing is left of it, and no start is pending."""
        return self.phase in INACTIVE and (not self.is_present or self.is_stuck)

    @property
    def container(self) -> ContainerConfig | None:
        return self.config if isinstance(self.config, ContainerConfig) else None

    @property
    def takes_slot(self) -> bool:
        """Whether it counts among those that start at the same time; not if something else does."""
        return isinstance(self.config, ContainerConfig) and not self.config.attach

    @property
    def runs(self) -> bool:
        """Whether it is ready; then composable nodes can be loaded into a container."""
        return self.phase is Phase.RUNNING and self.exit is None


class Node(_Unit, frozen=True, kw_only=True):
    """A composable node of the configuration."""

    config: ComposableNodeConfig
    state: NodeState = NodeState.PENDING
    is_requested: bool = False
    """Whether an operator or a change requests a load; its container loads it otherwise."""
    loaded_into: int = 0
    """The start of its container that the latest load belongs to."""
    unique_id: int = 0
    """The container's number for that load; 0 while unknown."""
    resent: bool = False
    is_reload: bool = False
    """Whether that load followed a crash."""
    sent_at: float = 0.0
    query_at: float | None = None
    """When its container is queried about it, since it owes an answer."""
    next_at: float | None = None
    """When it is loaded again, or given up."""
    gives_up: str = ""
    """Why it is given up at that time; empty: it is loaded again."""
    cpu_time_ns: int = 0
    loaded_at: float | None = None
    took: float | None = None
    """Seconds of the latest load that was completed."""
    crashed_pid: int = 0
    """Of its process that crashed last."""
    crashes: int = 0
    reloads: int = 0
    reports: int = 0
    """Grows when the same state is reported again."""
    is_confirmed: bool = False
    """Whether it is known to be loaded only by the answer to a query."""
    refusals: int = 0
    """How often a load was refused by the supervisor."""
    finding: ProbeResult | None = None
    """Of the scratch process that caused the latest refusal."""
    full_node_name: str = ""
    died_constructing: str = ""
    """How its constructor died in this process of the container; empty: it did not."""
    has_renewed: bool = False
    """Whether its container was restarted for it, and it has not been loaded since."""
    blocked_since: float | None = None
    """Since when its executor is in the callback that is reported as blocking it."""
    stage: Stage = Stage.TRUSTED
    deaths: int = 0
    """Deaths of its container during its load, since the last load that the container survived."""
    excused: int = 0
    """Deaths that did not count as restarts because of it."""

    @property
    def key(self) -> NodeKey:
        return self.config.key

    @property
    def name(self) -> str:
        return self.key.name

    @property
    def member(self) -> str:
        return self.key.container

    @property
    def times(self) -> tuple[float, ...]:
        return _times(self.wait, self.query_at, self.next_at)


def _times(wait: Wait | None, *times: float | None) -> tuple[float, ...]:
    found = times if wait is None else (*times, wait.next_at, wait.report_due)
    return tuple(at for at in found if at is not None)


class Goal(Struct, frozen=True, kw_only=True):
    """A managed (lifecycle) node, and the state that it is brought to."""

    unit: str
    config: ManagedConfig
    state: ManagedState = ManagedState.ABSENT
    reason: str = ""
    instance: int = 0
    """The start or load that it belongs to; 0 while the node does not exist."""


UnitKey: TypeAlias = "str | NodeKey"
_AnyUnit = TypeVar("_AnyUnit", bound=Process | Node | Goal)


class Before(NamedTuple):
    """Units that have changed, as they were before; None: they did not exist."""

    processes: dict[str, Process | None]
    nodes: dict[NodeKey, Node | None]
    goals: dict[str, Goal | None]
    dismissed: frozenset[str] = frozenset()


class World:
    """A system. `play_launch.supervisor.reducer.reduce` changes it, and nothing else."""

    def __init__(
        self, config: ReplayConfig, *, starts: int = 16, limits: Limits | None = None
    ) -> None:
        self.config = config
        self.starts = starts
        """How many containers start at the same time, at most."""
        self.limits = limits or Limits()
        self.dismissed: frozenset[str] = frozenset()
        """The operator's overlay: what was stopped or unloaded, by name or key."""
        self.stop_reason: str | None = None
        """Why the whole system stops; None: it does not."""
        self.is_hurried = False
        self.is_ending = False
        """Whether the stop of the whole system was requested by a rule."""
        self.processes: dict[str, Process] = {}
        self.nodes: dict[NodeKey, Node] = {}
        self.goals: dict[str, Goal] = {}
        self.keys: dict[str, list[NodeKey]] = {}
        """Keys of the nodes of each container, as declared."""
        self.places: dict[UnitKey, int] = {}
        """Order of all units, as declared."""
        self.touched: set[UnitKey] = set()
        """Units that were changed since their rules were evaluated."""
        self.before = Before({}, {}, {})
        """Units that were changed since events were derived, as they were then."""
        self.waiting: set[UnitKey] = set()
        """Units whose rules depend on other units."""
        self.due: list[tuple[float, int, UnitKey]] = []
        """Heap of times at which something may be due; those that are outdated stay in it."""
        self.met: frozenset[tuple[Condition, str, str]] = frozenset()
        """Lines, files and the graph, as in `play_launch.supervisor.inputs.Found`."""
        self.starts_made = self.loads_made = 0
        self.change: Change | None = None
        self.stop_order: dict[str, frozenset[str]] = {}
        """Processes that are stopped before each process, once the system stops."""
        self.arrived: set[str] = set()
        """Units that were up once since their start, or failed for good."""
        members: list[ContainerConfig | ProcessConfig] = [*config.containers, *config.nodes]
        for member in members:
            self.declare(member)
        for unit, managed in config.managed.items():
            self.put(Goal(unit=unit, config=managed))

    @property
    def is_stopping(self) -> bool:
        return self.stop_reason is not None

    def nodes_of(self, container: str) -> Iterator[Node]:
        return (self.nodes[key] for key in tuple(self.keys.get(container, ())))

    def find(self, key: UnitKey) -> Process | Node | None:
        """Find a process by name, or a node by its key or the text of that."""
        if key in self.processes or (isinstance(key, str) and ":/" not in key):
            return self.processes.get(str(key))
        return self.nodes.get(NodeKey.parsed(key) if isinstance(key, str) else key)

    def declare(self, config: ContainerConfig | ProcessConfig | ComposableNodeConfig) -> None:
        """Put a new unit into the world, a container with its nodes."""
        if isinstance(config, ComposableNodeConfig):
            self.put(Node(config=config))
            return
        self.put(Process(config=config))
        for node in config.composable_nodes if isinstance(config, ContainerConfig) else ():
            self.put(Node(config=node))

    def put(self, unit: _AnyUnit, **values: object) -> _AnyUnit:
        """Put a unit into the world, with other values; return it as it is then."""
        new = replace(unit, **values) if values else unit
        if isinstance(new, Process):
            if new != (process := self.processes.get(new.key)):
                self.processes[new.key] = new
                self.before.processes.setdefault(new.key, process)
                self._note(new.key, process, new)
        elif isinstance(new, Node):
            if new != (node := self.nodes.get(new.key)):
                if node is None:
                    self.keys.setdefault(new.key.container, []).append(new.key)
                self.nodes[new.key] = new
                self.before.nodes.setdefault(new.key, node)
                self._note(new.key, node, new)
        elif new != (goal := self.goals.get(new.unit)):
            self.goals[new.unit] = new
            self.before.goals.setdefault(new.unit, goal)
            self.touched.add(new.unit)
        return new

    def _note(self, key: UnitKey, old: Process | Node | None, new: Process | Node) -> None:
        self.touched.add(key)
        place = self.places.setdefault(key, len(self.places))
        is_queued = isinstance(new, Process) and new.phase is Phase.QUEUED
        is_waiting = new.wait is not None or is_queued
        (self.waiting.add if is_waiting else self.waiting.discard)(key)
        for at in new.times:
            if old is None or at not in old.times:
                heappush(self.due, (at, place, key))

    def next_due(self) -> float | None:
        """When something is due next for a unit; None: time alone changes nothing."""
        while self.due:
            at, _, key = self.due[0]
            unit = self.find(key)
            if unit is not None and at in unit.times:
                return at
            heappop(self.due)
        return None

    def forget(self, unit: Process | Node | Goal) -> None:
        """Remove a unit; a container is removed with its nodes."""
        if isinstance(unit, Goal):
            self.before.goals.setdefault(unit.unit, self.goals.pop(unit.unit))
            return
        if isinstance(unit, Process):
            for node in self.nodes_of(unit.name):
                self.forget(node)
            self.before.processes.setdefault(unit.key, self.processes.pop(unit.key))
        else:
            self.keys[unit.key.container].remove(unit.key)
            self.before.nodes.setdefault(unit.key, self.nodes.pop(unit.key))
        self.waiting.discard(unit.key)


class Limits(Struct, frozen=True, kw_only=True):
    """Time limits, in seconds."""

    hello: float = 30.0
    """From the start of a container to its hello."""
    kill: float = 5.0
    """From SIGKILL to the exit; a process in an uninterruptible system call lives on."""
    report_interval: float = 15.0
    """Between two reports of a slow constructor, or of one that waits."""
    reload_after_leak: float = 3.0
    """For a reload beyond its usual time, when a dead node probably left a lock locked."""
    silence: float = BLOCKED_AFTER
    """For a callback, before it is reported as blocking the executor."""


def is_wanted(world: World, unit: Process | Node) -> bool:
    """Whether the configuration and the operator want it to run: the one place that knows.

    A node is wanted independently of its container.
    """
    if unit.is_removed:
        return False
    if isinstance(unit, Process):
        return not world.is_stopping and unit.name not in world.dismissed
    return str(unit.key) not in world.dismissed


def is_ours(process: Process) -> bool:
    """Whether it is a container of our own program."""
    config = process.container
    return config is not None and config.container_type is not ContainerType.STOCK
