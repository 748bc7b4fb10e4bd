"""Actions."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Iterable
from typing import Any

from .entities import Action
from .events import Shutdown as ShutdownEvent
from .substitutions import TextSubstitution
from .utilities import normalize_to_list_of_substitutions, perform_substitutions

__all__ = [
    "DeclareLaunchArgument",
    "EmitEvent",
    "ExecuteProcess",
    "GroupAction",
    "IncludeLaunchDescription",
    "LogInfo",
    "OpaqueCoroutine",
    "OpaqueFunction",
    "RegisterEventHandler",
    "SetEnvironmentVariable",
    "Shutdown",
    "TimerAction",
    "UnregisterEventHandler",
]


class GroupAction(Action):
    def __init__(self, actions: Iterable[Any]) -> None:
        super().__init__()
        self.actions = list(actions)

    def execute(self, context: Any) -> Any:
        return self.actions


class LogInfo(Action):
    def __init__(self, *, msg: str) -> None:
        super().__init__()
        self.msg = msg

    def execute(self, context: Any) -> Any:
        print(f"[INFO] {self.msg}")


class OpaqueFunction(Action):
    def __init__(self, *, function: Any) -> None:
        super().__init__()
        self.function = function

    def execute(self, context: Any) -> Any:
        return self.function(context)


class OpaqueCoroutine(Action):
    def __init__(self, *, coroutine: Any) -> None:
        super().__init__()
        assert asyncio.iscoroutinefunction(coroutine)


class SetEnvironmentVariable(Action):
    def __init__(self, name: str, value: str) -> None:
        super().__init__()
        self.pair = (name, value)

    def execute(self, context: Any) -> Any:
        os.environ[self.pair[0]] = self.pair[1]


class DeclareLaunchArgument(Action):
    def __init__(
        self, name: str, *, default_value: Any = None, description: str = "", choices: Any = None
    ) -> None:
        super().__init__()
        self.name = name
        self.description = description
        self.choices = choices
        self.default_value = (
            None if default_value is None else normalize_to_list_of_substitutions(default_value)
        )

    def execute(self, context: Any) -> Any:
        if self.name not in context.launch_configurations:
            if self.default_value is None:
                raise RuntimeError(f'Required launch argument "{self.name}" was not provided.')
            value = perform_substitutions(context, self.default_value)
            context.launch_configurations[self.name] = value


class _Set(Action):
    def __init__(self, name: str, value: Any) -> None:
        super().__init__()
        self.name = name
        self.value = normalize_to_list_of_substitutions(value)

    def execute(self, context: Any) -> Any:
        value = perform_substitutions(context, self.value)
        context.launch_configurations[self.name] = value


class IncludeLaunchDescription(Action):
    def __init__(self, source: Any, *, launch_arguments: Any = ()) -> None:
        super().__init__()
        self.source = source
        self.launch_arguments = tuple(launch_arguments)

    def execute(self, context: Any) -> Any:
        description = self.source.get_launch_description(context)
        return [*(_Set(*pair) for pair in self.launch_arguments), description]


class EmitEvent(Action):
    def __init__(self, *, event: Any) -> None:
        super().__init__()
        self.event = event

    def execute(self, context: Any) -> Any:
        context.emit_event_sync(self.event)


class Shutdown(EmitEvent):
    def __init__(self, *, reason: str = "reason not given") -> None:
        super().__init__(event=ShutdownEvent(reason=reason))


class RegisterEventHandler(Action):
    def __init__(self, event_handler: Any) -> None:
        super().__init__()
        self.event_handler = event_handler

    def execute(self, context: Any) -> Any:
        context.register_event_handler(self.event_handler)


class UnregisterEventHandler(Action):
    def __init__(self, event_handler: Any) -> None:
        super().__init__()
        self.event_handler = event_handler

    def execute(self, context: Any) -> Any:
        context.unregister_event_handler(self.event_handler)


class TimerAction(Action):
    def __init__(
        self, *, period: float, actions: Iterable[Any], cancel_on_shutdown: bool = True
    ) -> None:
        super().__init__()
        self.__cancel_on_shutdown = cancel_on_shutdown
        self.period = period
        self.actions = list(actions)

    def handle(self, context: Any) -> Any:
        return self.actions


class _Executable:
    def __init__(self, cmd: Any, cwd: Any, name: Any, env: Any) -> None:
        self.cmd = [normalize_to_list_of_substitutions(word) for word in cmd]
        self.name = None if name is None else normalize_to_list_of_substitutions(name)
        self.env = env
        self.final_cwd = cwd
        self.final_cmd: list[str] = []
        self.final_env: dict[str, str] = {}

    @property
    def final_name(self) -> str:
        return self.final_cmd[0]

    def prepare(self, context: Any) -> None:
        self.final_cmd = [perform_substitutions(context, word) for word in self.cmd]
        self.final_env = dict(os.environ) if self.env is None else dict(self.env)


class ExecuteLocal(Action):
    def __init__(
        self,
        *,
        cmd: Any,
        cwd: Any = None,
        name: Any = None,
        env: Any = None,
        shell: bool = False,
        on_exit: Any = None,
        output: Any = "log",
        output_format: str = "[{this.process_description.final_name}] {line}",
    ) -> None:
        super().__init__()
        self.__output_format = output_format
        self.process_description = _Executable(cmd, cwd, name, env)
        self.shell = shell
        self.emulate_tty = False
        self.output = normalize_to_list_of_substitutions(output)
        self.sigterm_timeout = self.sigkill_timeout = [TextSubstitution(text="5")]
        self.process_details: Any = None
        self.__on_exit = on_exit
        self.__respawn = False
        self.__respawn_delay = None
        self.__respawn_max_retries = -1

    def prepare(self, context: Any) -> None:
        self.process_description.prepare(context)
        self.process_details = {"action": self, "cmd": self.process_description.final_cmd}


class ExecuteProcess(ExecuteLocal):
    pass
