"""Visits a description as `launch.LaunchService` does, with its ends replaced: nothing is started.

What would be started becomes a record, what would be emitted an event that is followed later.
"""

from __future__ import annotations

import functools
import re
from collections import Counter
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final

import launch
import launch.actions
import launch.substitutions
import launch_ros.actions
import launch_ros.ros_adapters
from launch import LaunchDescriptionEntity
from launch.actions import IncludeLaunchDescription
from launch.event_handlers import OnProcessExit
from launch.utilities import perform_substitutions, type_utils

from play_launch.launch_files.records import Event
from play_launch.launch_files.ros_launch.units import Composables, record_process

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.launch_files.ros_launch.handlers import EventSimulation
    from play_launch.launch_files.ros_launch.scene import Scene


_DEEPEST: Final = 50
"""How deep includes are nested; a file that includes itself has no end."""


class Visitor:
    """Visits depth first, and knows where it is."""

    events: EventSimulation

    def __init__(self, scene: Scene) -> None:
        self._scene = scene

    def visit(self, entity: Any) -> None:
        """Visit an entity and what it yields."""
        if not isinstance(entity, LaunchDescriptionEntity):
            raise TypeError(f"{entity!r}, where a part of a description is expected")
        places = self._scene.places
        place = places.of_part(entity)
        is_include = isinstance(entity, IncludeLaunchDescription) and bool(place.file)
        before, self.events.current_part = self.events.current_part, entity
        visited, places.visited = places.visited, place if place.file else places.visited
        if is_include:
            if len(places.includes) >= _DEEPEST:
                raise RuntimeError(f"includes are nested deeper than {_DEEPEST}")
            places.includes.append(place)
            self._scene.passed.append({str(name) for name in _names(entity)})
        try:
            for below in entity.visit(self._scene.context) or ():
                self.visit(below)
        except BaseException as error:
            places.annotate(error, place)
            raise
        finally:
            self.events.current_part = before
            places.visited = visited
            if is_include:
                places.includes.pop()
                self._scene.passed.pop()


def _names(include: Any) -> list[str]:
    return [
        "".join(getattr(part, "text", "") for part in name) if isinstance(name, list) else name
        for name, _ in include.launch_arguments
    ]


def install(scene: Scene, events: EventSimulation) -> None:
    """Replace the ends of launch, for this process."""
    _processes(scene, events)
    _composables(scene)
    _lifecycle_nodes()
    _timers(scene, events)
    _events(scene, events)
    _arguments(scene)
    _what_needs_a_run(scene)
    _what_is_done_later(scene)
    _anonymous_names(scene)


def _processes(scene: Scene, events: EventSimulation) -> None:
    construct = launch.actions.ExecuteLocal.__init__

    def __init__(self: Any, **named: Any) -> None:  # noqa: N807
        # `log` is the default as well, and a configuration has another one.
        self.play_launch_has_output = "output" in named
        construct(self, **named)

    _replace(launch.actions.ExecuteLocal, "__init__", __init__)

    executed: set[int] = set()

    def execute(self: Any, context: Any) -> None:
        self.prepare(context)
        if id(self) in executed:
            if not scene.causes.now:
                name = self.process_description.final_name
                raise RuntimeError(f"{name}: executed more than once: {self.describe()}")
            scene.lost(self, "starts again and again with the events of others")
            return
        executed.add(id(self))
        process = record_process(scene, self)
        scene.add(process)
        events.executed(self, process)
        on_exit = self._ExecuteLocal__on_exit
        if on_exit is not None:
            context.register_event_handler(OnProcessExit(target_action=self, on_exit=on_exit))

    _replace(launch.actions.ExecuteLocal, "execute", execute)

    write = launch_ros.actions.Node._create_params_file_from_dict  # noqa: SLF001

    def create(self: Any, params: Any) -> Any:
        path = write(self, params)
        scene.written.add(path)
        return path

    _replace(launch_ros.actions.Node, "_create_params_file_from_dict", create)


def _composables(scene: Scene) -> None:
    composables = Composables(scene)

    def execute(self: Any, context: Any) -> None:  # noqa: ARG001
        for composable in composables.of(self):
            scene.add(composable)

    _replace(launch_ros.actions.LoadComposableNodes, "execute", execute)


def _lifecycle_nodes() -> None:
    def execute(self: Any, context: Any) -> Any:
        self._perform_substitutions(context)
        if "<node_name_unspecified>" in self.node_name:
            raise RuntimeError("node_name unexpectedly incomplete for lifecycle node")
        return launch_ros.actions.Node.execute(self, context)

    _replace(launch_ros.actions.LifecycleNode, "execute", execute)


def _timers(scene: Scene, events: EventSimulation) -> None:
    def execute(self: Any, context: Any) -> None:
        seconds = type_utils.perform_typed_substitution(context, self.period, float)
        self._TimerAction__context_locals = dict(context.get_locals_as_dict())
        if isinstance(self, launch_ros.actions.ROSTimer):
            scene.lost(self, "ROSTimer: it counts the time of the machine, not that of ROS")
        events.timed(self, seconds)

    for kind in (launch.actions.TimerAction, launch_ros.actions.ROSTimer):
        _replace(kind, "execute", execute)


def _events(scene: Scene, events: EventSimulation) -> None:
    def emit_event_sync(self: Any, event: Any) -> None:  # noqa: ARG001
        events.post(event)

    async def emit_event(self: Any, event: Any) -> None:  # noqa: ARG001
        events.post(event)

    register = launch.LaunchContext.register_event_handler

    def register_event_handler(self: Any, event_handler: Any, append: bool = False) -> None:
        if events.registers(event_handler):
            register(self, event_handler, append=append)

    unregister = launch.actions.UnregisterEventHandler.execute

    def execute(self: Any, context: Any) -> None:
        if scene.causes.now:
            when = scene.described(scene.causes.now)
            scene.lost(self, f"UnregisterEventHandler when {when}: the handler stays")
        else:
            # One that is not followed was never registered.
            with suppress(ValueError):
                unregister(self, context)

    _replace(launch.actions.UnregisterEventHandler, "execute", execute)
    _replace(launch.LaunchContext, "emit_event_sync", emit_event_sync)
    _replace(launch.LaunchContext, "emit_event", emit_event)
    _replace(launch.LaunchContext, "register_event_handler", register_event_handler)


def _arguments(scene: Scene) -> None:
    execute_of_launch = launch.actions.DeclareLaunchArgument.execute

    def execute(self: Any, context: Any) -> Any:
        # One that an include has set cannot be given.
        is_passed = any(self.name in names for names in scene.passed)
        is_set = self.name in context.launch_configurations
        if not is_passed and (self.name in scene.given or not is_set):
            scene.declared(self, default_of(self, context))
        return execute_of_launch(self, context)

    _replace(launch.actions.DeclareLaunchArgument, "execute", execute)


def default_of(action: Any, context: Any) -> str | None:
    """Return the default of a launch argument as a text, described where it has no value yet."""
    if action.default_value is None:
        return None
    try:
        return str(perform_substitutions(context, action.default_value))
    except Exception:  # noqa: BLE001 - whatever a substitution raises; it may never be needed
        return "".join(each.describe() for each in action.default_value)


def _what_needs_a_run(scene: Scene) -> None:
    """Replace what a run needs: coroutines, and nodes of the launch itself."""

    def coroutine(self: Any, context: Any) -> None:  # noqa: ARG001
        scene.lost(self, "OpaqueCoroutine: what a function does while the system runs")

    def use_sim_time(self: Any, context: Any) -> None:  # noqa: ARG001
        scene.lost(self, "SetUseSimTime: it is for the timers of launch itself", is_note=True)

    def adapter(*_: Any, **__: Any) -> None:
        raise RuntimeError("a launch file that is only evaluated has no node of ROS of its own")

    _replace(launch.actions.OpaqueCoroutine, "execute", coroutine)
    _replace(launch_ros.actions.SetUseSimTime, "execute", use_sim_time)
    launch_ros.ros_adapters.get_ros_adapter = adapter


def _what_is_done_later(scene: Scene) -> None:
    """Report what is logged and called later: nothing runs yet."""
    log = launch.actions.LogInfo.execute
    call = launch.actions.OpaqueFunction.execute

    def execute_log(self: Any, context: Any) -> Any:
        if not scene.causes.now:
            return log(self, context)
        scene.lost(self, f"LogInfo when {scene.described(scene.causes.now)}", is_note=True)
        return None

    def execute_function(self: Any, context: Any) -> Any:
        follows_event = any(each.event is not Event.DELAY for each in scene.causes.now)
        # launch has functions of its own, which are made in no launch file.
        if not follows_event or not scene.places.of_part(self).file:
            return call(self, context)
        # It may release brakes.
        when = scene.described(scene.causes.now)
        scene.lost(self, f"OpaqueFunction when {when}: it is not called")
        return None

    _replace(launch.actions.LogInfo, "execute", execute_log)
    _replace(launch.actions.OpaqueFunction, "execute", execute_function)


def _anonymous_names(scene: Scene) -> None:
    """Give anonymous names that are the same in each evaluation, and each only once."""
    counts: Counter[str] = Counter()

    def compute_name(self: Any, id_value: str) -> str:  # noqa: ARG001
        name = re.sub(r"[.:-]", "_", id_value) + "_anonymous"
        counts[name] += 1
        found = name if counts[name] == 1 else f"{name}_{counts[name]}"
        scene.lost(None, f"the anonymous name {id_value} is always {found}", is_note=True)
        return found

    if hasattr(launch.substitutions, "AnonName"):
        _replace(launch.substitutions.AnonName, "compute_name", compute_name)


def _replace(kind: type, name: str, function: Callable[..., Any]) -> None:
    original = getattr(kind, name)
    setattr(kind, name, functools.wraps(original)(function))
