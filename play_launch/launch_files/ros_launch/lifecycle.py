"""Managed nodes as a launch file drives them: which transitions it asks for, and when."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple

from launch_ros.events.lifecycle import ChangeState, StateTransition
from lifecycle_msgs.msg import Transition, TransitionEvent

from play_launch.config.model import Autostart
from play_launch.launch_files.records import Event, StartCondition

if TYPE_CHECKING:
    from collections.abc import Callable

    from play_launch.launch_files.records import Process
    from play_launch.launch_files.ros_launch.causes import Conditions
    from play_launch.launch_files.ros_launch.scene import Scene


class _Step(NamedTuple):
    label: str
    start: str
    between: str
    goal: str


# As the state machine of rcl_lifecycle has it, where every transition succeeds.
_STEPS: Final = {
    Transition.TRANSITION_CONFIGURE: _Step("configure", "unconfigured", "configuring", "inactive"),
    Transition.TRANSITION_CLEANUP: _Step("cleanup", "inactive", "cleaningup", "unconfigured"),
    Transition.TRANSITION_ACTIVATE: _Step("activate", "inactive", "activating", "active"),
    Transition.TRANSITION_DEACTIVATE: _Step("deactivate", "active", "deactivating", "inactive"),
    Transition.TRANSITION_UNCONFIGURED_SHUTDOWN: _Step(
        "shutdown", "unconfigured", "shuttingdown", "finalized"
    ),
    Transition.TRANSITION_INACTIVE_SHUTDOWN: _Step(
        "shutdown", "inactive", "shuttingdown", "finalized"
    ),
    Transition.TRANSITION_ACTIVE_SHUTDOWN: _Step("shutdown", "active", "shuttingdown", "finalized"),
}
_AUTOSTART: Final = {"configure": Autostart.CONFIGURE, "activate": Autostart.ACTIVATE}
_SUCCESS: Final = "transition_success"


class Lifecycles:
    """The states of the managed nodes; `post` takes an event and the conditions it stands for."""

    def __init__(self, scene: Scene, post: Callable[[Any, Conditions], None]) -> None:
        self._scene = scene
        self._post = post
        self._nodes: list[tuple[Any, Process]] = []
        self._states: dict[str, str] = {}

    def add(self, action: Any, process: Process) -> None:
        """Take a node, which is unconfigured once it runs."""
        self._nodes.append((action, process))
        self._states[process.id] = "unconfigured"

    def change(self, event: ChangeState, conditions: Conditions, part: Any) -> None:
        """Carry out a transition of the nodes that an event is for."""
        found = [pair for pair in self._nodes if event.lifecycle_node_matcher(pair[0])]
        if not found:
            name = ChangeState.valid_transitions[event.transition_id]
            self._scene.lost(part, f"{name} for a node that is no LifecycleNode of the launch file")
        for action, process in found:
            self._step(action, process, event.transition_id, conditions)

    def _step(self, action: Any, process: Process, number: int, conditions: Conditions) -> None:
        step = _STEPS.get(number)
        state = self._states[process.id]
        if step is None or step.start != state:
            name = step.label if step else ChangeState.valid_transitions[number]
            self._scene.lost(process, f"the transition {name}, which is not possible when {state}")
            return
        self._note(process, step, conditions)
        self._states[process.id] = step.goal
        for label, start, goal in (
            (step.label, step.start, step.between),
            (_SUCCESS, step.between, step.goal),
        ):
            message = TransitionEvent()
            message.transition.label = label
            message.start_state.label = start
            message.goal_state.label = goal
            condition = StartCondition(event=Event.STATE, unit=process.id, state=goal)
            self._post(StateTransition(action=action, msg=message), (condition,))

    def _note(self, process: Process, step: _Step, conditions: Conditions) -> None:
        """Write how far the node is brought; report where that has further conditions."""
        if step.label not in _AUTOSTART:
            self._scene.lost(
                process, f"the transition {step.label} when {self._scene.described(conditions)}"
            )
            return
        process.autostart = _AUTOSTART[step.label]
        own = self._scene.causes.of_unit(process.id)
        foreign = tuple(each for each in conditions if each.unit != process.id and each not in own)
        if foreign:
            self._scene.lost(
                process,
                f"{step.label} only when {self._scene.described(foreign)}; it is done at once",
            )
