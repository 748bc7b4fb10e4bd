"""Records of what would be started: `ExecuteLocal` and its kinds, and load requests."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import TYPE_CHECKING, Any, Final

from launch.conditions import evaluate_condition_expression
from launch.utilities import normalize_to_list_of_substitutions, perform_substitutions
from launch_ros.actions import ComposableNodeContainer, LifecycleNode, Node, load_composable_nodes

from play_launch.launch_files.parameters import take_sections
from play_launch.launch_files.records import (
    OUTPUTS,
    Composable,
    LaunchedProcess,
    ProgramKind,
    Values,
)
from play_launch.launch_files.ros_launch.rcl_parameters import (
    RclParameters,
    RclParametersError,
    parameter_of,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from play_launch.config.model import ParameterConfig
    from play_launch.launch_files.records import ParameterFile, Source
    from play_launch.launch_files.ros_launch.scene import Scene

_ROS_ARGUMENTS: Final = "--ros-args"
_DEFAULT_OUTPUT: Final = "log"
_DEFAULT_TIMEOUT: Final = 5.0
_DEFAULT_FORMAT: Final = "[{this.process_description.final_name}] {line}"


def record_process(scene: Scene, action: Any) -> LaunchedProcess:
    """Return the record of an action that is about to be executed and has been prepared."""
    process = LaunchedProcess(
        id=scene.next_id("p"),
        origin=scene.places.of_part(action),
        start=list(scene.causes.now),
    )
    description = action.process_description
    words = [str(word) for word in description.final_cmd]
    count = len(words) - len(description.cmd)
    process.prefix, words = words[:count], words[count:]
    if isinstance(action, Node):
        _read_node(scene, process, action, words)
    else:
        process.kind = ProgramKind.PROCESS
        process.command = words
    process.shell = bool(action.shell)
    if process.shell and process.kind is ProgramKind.PROCESS:
        # The one line that launch gives to a shell.
        process.command = [" ".join([*process.prefix, *words])]
        process.prefix = []
    _read_settings(scene, process, action)
    _read_environment(scene, process, description.final_env)
    return process


def _read_settings(scene: Scene, process: LaunchedProcess, action: Any) -> None:
    context, description = scene.context, action.process_description
    if description.name is not None:
        process.label = perform_substitutions(context, description.name)
    process.cwd = description.final_cwd or scene.changed_folder()
    process.emulate_tty = bool(action.emulate_tty)
    if "emulate_tty" in context.launch_configurations:
        process.emulate_tty = evaluate_condition_expression(
            context,
            normalize_to_list_of_substitutions(context.launch_configurations["emulate_tty"]),
        )
    process.respawn = bool(_private(action, "respawn"))
    delay = _private(action, "respawn_delay")
    process.respawn_delay = None if delay is None else float(delay)
    process.respawn_max_retries = int(_private(action, "respawn_max_retries"))
    process.sigterm_timeout = _timeout(scene, action.sigterm_timeout)
    process.sigkill_timeout = _timeout(scene, action.sigkill_timeout)
    if getattr(action, "_ExecuteLocal__output_format", _DEFAULT_FORMAT) != _DEFAULT_FORMAT:
        scene.lost(process, "output_format: lines are shown and recorded as they are", is_note=True)
    has_output = action.play_launch_has_output
    process.output = _output(scene, process, action.output, has_output=has_output)


def _private(action: Any, name: str) -> Any:
    """Return an attribute of ExecuteLocal that has no getter."""
    return getattr(action, f"_ExecuteLocal__{name}")


def _timeout(scene: Scene, value: Any) -> float | None:
    """Return the seconds; None for those that launch takes where nothing is said."""
    seconds = float(perform_substitutions(scene.context, value))
    return None if seconds == _DEFAULT_TIMEOUT else seconds


def _output(scene: Scene, process: LaunchedProcess, output: Any, *, has_output: bool) -> str:
    if isinstance(output, dict):
        stdout, stderr = (_is_shown(output, stream) for stream in ("stdout", "stderr"))
        if stdout == stderr:
            return "screen" if stdout else "log"
        scene.lost(process, f"output: {output}; another one for stdout and stderr is not possible")
        return ""
    text = perform_substitutions(scene.context, output)
    if text not in OUTPUTS:
        raise RuntimeError(f"{text!r} is no output; {', '.join(sorted(OUTPUTS))} are")
    return text if text != _DEFAULT_OUTPUT or has_output else ""


def _is_shown(output: Mapping[str, Any], stream: str) -> bool:
    given = (output.get(key, ()) for key in ("both", stream))
    return any("screen" in ({each} if isinstance(each, str) else each) for each in given)


def _read_environment(
    scene: Scene, process: LaunchedProcess, environment: Mapping[str, str]
) -> None:
    before = scene.environment
    process.environment = [
        (name, value) for name, value in sorted(environment.items()) if before.get(name) != value
    ]
    process.unset = sorted(before.keys() - environment.keys())


def _read_node(scene: Scene, process: LaunchedProcess, action: Any, words: list[str]) -> None:
    is_container = isinstance(action, ComposableNodeContainer)
    process.kind = ProgramKind.CONTAINER if is_container else ProgramKind.NODE
    process.is_lifecycle = isinstance(action, LifecycleNode)
    process.arguments, process.ros_arguments, added = _parted(action, words)
    if action.node_package is None:
        process.command, process.arguments = [words[0], *process.arguments], []
    else:
        process.package = _performed(scene, action.node_package)
        process.executable = _performed(scene, action.node_executable)
    _read_added(scene, process, added)


def _performed(scene: Scene, text: Any) -> str:
    found: str = perform_substitutions(scene.context, normalize_to_list_of_substitutions(text))
    return found


def _parted(action: Any, words: list[str]) -> tuple[list[str], list[str], list[str]]:
    """Return the arguments, those for ROS, and what launch_ros adds after a last `--ros-args`."""
    arguments = getattr(action, "_Node__arguments", None)
    ros_arguments = getattr(action, "_Node__ros_arguments", None)
    at = 1 + (len(arguments) if isinstance(arguments, Collection) else 0)
    if arguments is not None and not isinstance(arguments, Collection):
        # A generator, which is used up: launch_ros puts its own behind the last one.
        at = len(words) - 1 - words[::-1].index(_ROS_ARGUMENTS)
    own, rest = words[1:at], words[at:]
    for_ros = list(ros_arguments) if isinstance(ros_arguments, Collection) else []
    count = len(for_ros) + 1 if ros_arguments is not None else 0
    return own, rest[1:count] if count else [], rest[count + 1 :]


def _read_added(scene: Scene, process: LaunchedProcess, added: list[str]) -> None:
    """Read what launch_ros puts behind the arguments: names, parameters, remappings."""
    reader = RclParameters()
    try:
        left = iter(added)
        for word in left:
            value = next(left, None) if word in {"-r", "-p", "--params-file"} else None
            if value is None:
                process.ros_arguments.append(word)
            elif word == "-r":
                _read_remapping(process, value)
            else:
                _read_parameters(scene, process, reader, word, value)
        take_sections(process, reader.sections())
    finally:
        reader.close()


def _read_remapping(process: LaunchedProcess, rule: str) -> None:
    source, _, target = rule.partition(":=")
    if source == "__node":
        process.name = target
    elif source == "__ns":
        process.namespace = target
    else:
        process.remappings.append((source, target))


def _read_parameters(
    scene: Scene, process: LaunchedProcess, reader: RclParameters, word: str, value: str
) -> None:
    try:
        if word == "-p":
            reader.add_rule(value)
            process.sources += _values(value, is_file=False)
        else:
            reader.add_file(value)
            # launch_ros has written what the launch file gives as values.
            is_written = value in scene.written
            found = _values(value, is_file=True) if is_written else [scene.parameter_file(value)]
            process.sources += found
    except RclParametersError as error:
        what = "the parameter" if word == "-p" else "the parameter file"
        scene.lost(process, f"rcl refuses {what} {value.strip()}: {error}")


def _values(text: str, *, is_file: bool) -> list[Source]:
    """Return what rcl reads of a single source."""
    reader = RclParameters()
    try:
        if is_file:
            reader.add_file(text)
        else:
            reader.add_rule(text)
        return [Values(section.parameters, section.pattern) for section in reader.sections()]
    finally:
        reader.close()


class Composables:
    """Makes the records of the composable nodes of one evaluation.

    Parameters are taken before launch_ros makes messages of them, which takes longer than all the
    rest. Their files are looked at then as well, as temporary ones do not stay.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._taken: list[tuple[list[ParameterConfig], list[ParameterFile]]] = []
        self._to_parameters_list = load_composable_nodes.to_parameters_list
        load_composable_nodes.to_parameters_list = self._take

    def _take(
        self, context: Any, name: str, namespace: str, evaluated: Iterable[Any]
    ) -> list[object]:
        sources = list(evaluated)
        found = self._to_parameters_list(context, name, namespace, sources)
        # As they are given; launch_ros resolves links in those of the context, which come first.
        for number, each in enumerate(context.launch_configurations.get("global_params") or ()):
            if not isinstance(each, tuple) and number < len(sources):
                sources[number] = each
        files = [
            self._scene.parameter_file(str(each)) for each in sources if not isinstance(each, dict)
        ]
        self._taken.append((_last_of_each(found), files))
        return []

    def of(self, action: Any) -> list[Composable]:
        """Return the records of the nodes that a LoadComposableNodes action loads."""
        container = self._container(action)
        found = []
        for description in action._LoadComposableNodes__composable_node_descriptions:  # noqa: SLF001
            self._taken.clear()
            request = load_composable_nodes.get_composable_node_load_request(
                description, self._scene.context
            )
            if request is not None:
                found.append(self._record(action, description, request, container))
        return found

    def _container(self, action: Any) -> str:
        target = action._LoadComposableNodes__target_container  # noqa: SLF001
        if isinstance(target, ComposableNodeContainer):
            name = target.node_name
        else:
            parts = normalize_to_list_of_substitutions(target)
            name = perform_substitutions(self._scene.context, parts)
        return name if name.startswith("/") else f"/{name}"

    def _record(self, action: Any, description: Any, request: Any, container: str) -> Composable:
        has_extra = description.extra_arguments is not None
        extra = self._taken.pop()[0] if has_extra else []
        parameters, files = self._taken.pop() if self._taken else ([], [])
        places = self._scene.places
        place = places.of_part(description)
        return Composable(
            id=self._scene.next_id("c"),
            origin=place if place.file else places.of_part(action),
            start=list(self._scene.causes.now),
            package=request.package_name,
            plugin=request.plugin_name,
            name=request.node_name,
            namespace=request.node_namespace,
            container=container,
            remappings=[_pair(rule) for rule in request.remap_rules],
            sources=list(files),
            parameters=parameters,
            extra_arguments=extra,
        )


def _pair(rule: str) -> tuple[str, str]:
    source, _, target = rule.partition(":=")
    return source, target


def _last_of_each(parameters: Iterable[Any]) -> list[ParameterConfig]:
    """Return what a component gets of a request: of a name that stands twice, the last value."""
    found = map(parameter_of, parameters)
    return list({each.name: each for each in found if each is not None}.values())
