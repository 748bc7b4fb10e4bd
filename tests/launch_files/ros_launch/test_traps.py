"""Launch files with something in them that is easily evaluated in another way than ROS does it."""

from __future__ import annotations

import pytest

from play_launch.config.model import ParameterType, ParameterValue
from play_launch.launch_files.records import LaunchedProcess, ParameterFile, ProgramKind, Values
from tests.launch_files.ros_launch.prefix import (
    Prefix,
    composables,
    needs_launch,
    prefix,
    processes,
)

__all__ = ["prefix"]
pytestmark = needs_launch

HEAD = """
from launch import LaunchDescription
from launch.actions import *
from launch.substitutions import *
from launch_ros.actions import *
from launch_ros.descriptions import *
"""


def python(*entities: str, before: str = "") -> str:
    lines = ",\n        ".join(entities)
    return f"""{HEAD}{before}
def generate_launch_description():
    return LaunchDescription([
        {lines},
    ])
"""


def values(process: LaunchedProcess) -> dict[str, object]:
    return {each.name: each.value.value for each in process.parameters}


def test_a_node(prefix: Prefix) -> None:
    text = """
<launch>
  <group>
    <push-ros-namespace namespace="robot"/>
    <set_remap from="global" to="/g"/>
    <node pkg="pkg" exec="talker" name="t" namespace="arm" args="one 'two words'"
          ros_args="--log-level debug" respawn="true" respawn_delay="1.5" output="screen"
          launch-prefix="nice -n 5" cwd="/tmp" emulate_tty="true" on_exit="shutdown"
          sigterm_timeout="7" exec_name="label">
      <param name="a.b" value="1"/>
      <remap from="chatter" to="/c"/>
      <env name="LEVEL" value="3"/>
    </node>
  </group>
  <node pkg="pkg" exec="listener"/>
</launch>
"""
    talker, listener = processes(prefix.evaluate("a.launch.xml", text))
    assert talker.kind is ProgramKind.NODE
    assert (talker.package, talker.executable, talker.label) == ("pkg", "talker", "label")
    assert (talker.full_name, talker.cwd, talker.output) == ("/robot/arm/t", "/tmp", "screen")
    assert talker.arguments == ["one", "two words"]
    assert talker.ros_arguments == ["--log-level", "debug"]
    assert talker.prefix == ["nice", "-n", "5"]
    assert talker.remappings == [("global", "/g"), ("chatter", "/c")]
    assert talker.environment == [("LEVEL", "3")]
    assert (talker.respawn, talker.respawn_delay) == (True, 1.5)
    assert talker.emulate_tty
    assert talker.ends_all
    assert (talker.sigterm_timeout, talker.sigkill_timeout) == (7.0, None)
    assert values(talker) == {"a.b": 1}
    assert talker.origin.line == 5
    assert (listener.name, listener.namespace, listener.remappings) == ("", "", [])
    assert listener.origin.line == 14


def test_sections_count_in_the_order_of_their_first_mention(prefix: Prefix) -> None:
    """What comes later does not always win."""
    file = prefix.file("p.yaml", "/**: {ros__parameters: {a: 2}}\n")
    node = "Node(package='pkg', executable='talker', name='t', namespace='/', parameters=[{}])"
    one = node.format(
        f"{{{{'a': 1}}}}, {str(file)!r}, {{{{'a': 3}}}}".replace("{{", "{").replace("}}", "}")
    )
    other = node.format(f"{str(file)!r}, {{'a': 1}}, {str(file)!r}")
    first, second = processes(prefix.evaluate("a.launch.py", python(one, other)))
    assert values(first) == {"a": 2}
    assert values(second) == {"a": 1}
    assert [type(each) for each in first.sources] == [Values, ParameterFile, Values]
    assert isinstance(first.sources[0], Values)
    assert first.sources[0].pattern == "/t"


def test_parameters_for_other_nodes_of_the_process(prefix: Prefix) -> None:
    file = prefix.file(
        "p.yaml",
        "server: {ros__parameters: {a: 1}}\n"
        "costmap: {costmap: {ros__parameters: {size: 2, deep: {er: 3}}}}\n",
    )
    node = f'<node pkg="pkg" exec="talker" name="server"><param from="{file}"/></node>'
    text = f"<launch>\n{node}\n</launch>\n"
    (server,) = processes(prefix.evaluate("a.launch.xml", text))
    assert values(server) == {"a": 1}
    (others,) = server.for_others
    assert others.pattern == "/costmap/costmap"
    assert {each.name: each.value.value for each in others.parameters} == {"size": 2, "deep.er": 3}


def test_global_parameters_leak_once_one_was_set(prefix: Prefix) -> None:
    text = """
<launch>
  <set_parameter name="one" value="1"/>
  <group>
    <set_parameter name="two" value="2"/>
  </group>
  <node pkg="pkg" exec="talker"/>
</launch>
"""
    (talker,) = processes(prefix.evaluate("a.launch.xml", text))
    assert values(talker) == {"one": 1, "two": 2}


def test_includes_do_not_scope(prefix: Prefix) -> None:
    prefix.file(
        "b.launch.xml",
        '<launch><push-ros-namespace namespace="n"/><let name="x" value="$(var y)"/></launch>\n',
    )
    text = f"""
<launch>
  <let name="y" value="first"/>
  <include file="{prefix.folder}/b.launch.xml"/>
  <let name="y" value="second"/>
  <node pkg="pkg" exec="talker" name="t" args="$(var x) $(var y)"/>
  <group>
    <include file="{prefix.folder}/b.launch.xml"/>
    <node pkg="pkg" exec="talker" name="t" args="$(var x)"/>
  </group>
  <node pkg="pkg" exec="talker" name="u" args="$(var x)"/>
</launch>
"""
    found = processes(prefix.evaluate("a.launch.xml", text))
    assert [each.full_name for each in found] == ["/n/t", "/n/n/t", "/n/u"]
    assert [each.arguments for each in found] == [["first", "second"], ["second"], ["first"]]


def test_composable_nodes(prefix: Prefix) -> None:
    """They get the namespace of the context and not that of their container."""
    text = """
<launch>
  <set_remap from="a" to="/first"/>
  <node_container pkg="pkg" exec="component_container" name="c" namespace="boxes">
    <param name="p" value="1"/>
    <composable_node pkg="demo" plugin="demo::A" name="a">
      <param name="text" value="010"/>
      <remap from="a" to="/second"/>
      <extra_arg name="use_intra_process_comms" value="true"/>
    </composable_node>
    <composable_node pkg="demo" plugin="demo::B" name="b" if="false"/>
  </node_container>
  <load_composable_node target="/elsewhere/c">
    <composable_node pkg="demo" plugin="demo::C" name="c" namespace="x"/>
  </load_composable_node>
</launch>
"""
    found = prefix.evaluate("a.launch.xml", text)
    (container,) = processes(found)
    assert container.kind is ProgramKind.CONTAINER
    assert values(container) == {"p": 1}
    assert container.remappings == [("a", "/first")]
    first, other = composables(found)
    assert (first.full_name, first.container) == ("/a", "/boxes/c")
    assert (first.package, first.plugin) == ("demo", "demo::A")
    assert first.remappings == [("a", "/first"), ("a", "/second")]
    assert [(each.name, each.value.type, each.value.value) for each in first.parameters] == [
        ("text", ParameterType.INTEGER, 8)
    ]
    assert [(each.name, each.value.value) for each in first.extra_arguments] == [
        ("use_intra_process_comms", True)
    ]
    assert first.origin.line == 5
    assert (other.full_name, other.container) == ("/x/c", "/elsewhere/c")


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [
        ("010", ParameterType.INTEGER, 8),
        ("10:30", ParameterType.INTEGER, 630),
        ("yes", ParameterType.BOOL, True),
        ("1e3", ParameterType.DOUBLE, 1000.0),
        ("'1'", ParameterType.STRING, "1"),
        ("[1, 2]", ParameterType.INTEGER_ARRAY, (1, 2)),
    ],
)
def test_types(prefix: Prefix, text: str, kind: ParameterType, value: object) -> None:
    node = f'<node pkg="pkg" exec="talker"><param name="x" value="{text}"/></node>'
    xml = f"<launch>\n{node}\n</launch>\n"
    (talker,) = processes(prefix.evaluate("a.launch.xml", xml))
    (found,) = talker.parameters
    assert found.value == ParameterValue(kind, value)  # type: ignore[arg-type] # as the table says


def test_strings_that_launch_writes_without_quotes(prefix: Prefix) -> None:
    """launch_ros writes `y` bare into a list; rcl then refuses the list, and the node its start."""
    node = "Node(package='pkg', executable='talker', parameters=[{'l': ['y', 'x'], 'a': 1}])"
    found = prefix.evaluate("a.launch.py", python(node))
    assert any("rcl refuses" in loss.what for loss in found.losses)


def test_temporary_parameter_files_keep_their_text(prefix: Prefix) -> None:
    file = prefix.file("p.yaml", "/**: {ros__parameters: {a: $(var x)}}\n")
    text = f"""
<launch>
  <let name="x" value="7"/>
  <node pkg="pkg" exec="talker"><param from="{file}" allow_substs="true"/></node>
</launch>
"""
    (talker,) = processes(prefix.evaluate("a.launch.xml", text))
    assert values(talker) == {"a": 7}
    (source,) = talker.sources
    assert isinstance(source, ParameterFile)
    assert source.text is not None
    assert "a: 7" in source.text


def test_a_temporary_file_that_is_an_argument_is_kept(prefix: Prefix) -> None:
    text = python(
        "Node(package='pkg', executable='talker', arguments=[made.name, folder + '/none'])",
        before=(
            "import tempfile\nmade = tempfile.NamedTemporaryFile(delete=False)\n"
            "made.write(b'x'); made.close(); folder = tempfile.mkdtemp()\n"
        ),
    )
    found = prefix.evaluate("a.launch.py", text)
    (talker,) = processes(found)
    (file,) = found.temporary
    assert (file.path, file.content) == (talker.arguments[0], b"x")
    (loss,) = found.losses
    assert "temporary file" in loss.what
    assert loss.where.startswith(f"{prefix.folder}/a.launch.py:")


def test_a_container_is_what_a_plain_node_is(prefix: Prefix) -> None:
    """Such as that of Nav2: the container is known by its name alone."""
    text = """
<launch>
  <node pkg="pkg" exec="component_container" name="nav2_container"/>
  <load_composable_node target="nav2_container">
    <composable_node pkg="demo" plugin="demo::A" name="a"/>
  </load_composable_node>
</launch>
"""
    found = prefix.evaluate("a.launch.xml", text)
    assert processes(found)[0].kind is ProgramKind.NODE
    assert composables(found)[0].container == "/nav2_container"


def test_arguments(prefix: Prefix) -> None:
    prefix.file(
        "b.launch.xml",
        '<launch><arg name="passed"/><arg name="open" default="2"/></launch>\n',
    )
    text = f"""
<launch>
  <arg name="robot" description="Which one">
    <choice value="a"/><choice value="b"/>
  </arg>
  <include file="{prefix.folder}/b.launch.xml"><arg name="passed" value="1"/></include>
</launch>
"""
    found = prefix.evaluate("a.launch.xml", text, {"robot": "a"})
    names = [(each.name, each.default, each.choices) for each in found.arguments]
    assert names == [("robot", None, ("a", "b")), ("open", "2", ())]
    error = prefix.error("a.launch.xml", text, {"robot": "c"})
    assert error.startswith('a.launch.xml:2: Argument "robot" provided value "c" is not valid')
    declared = prefix.evaluate("a.launch.xml", text, only_arguments=True)
    assert declared.units == []
    assert "robot" in [each.name for each in declared.arguments]


def test_anonymous_names_stay_the_same(prefix: Prefix) -> None:
    node = '<node pkg="pkg" exec="talker" name="$(anon a-b)"/>'
    text = f"<launch><group>{node}{node}</group>{node}</launch>"
    found = prefix.evaluate("a.launch.xml", text)
    names = ["a_b_anonymous", "a_b_anonymous", "a_b_anonymous_2"]
    assert [each.name for each in processes(found)] == names
    assert prefix.evaluate("a.launch.xml", text) == found


@pytest.mark.parametrize(("output", "found"), [("", ""), ('output="log"', "log")])
def test_output_that_is_the_default(prefix: Prefix, output: str, found: str) -> None:
    text = f'<launch><executable cmd="true" {output}/></launch>'
    assert [each.output for each in processes(prefix.evaluate("a.launch.xml", text))] == [found]


@pytest.mark.parametrize(
    ("output", "found"),
    [
        ({"both": "screen"}, "screen"),
        ({"stdout": "screen", "stderr": "screen"}, "screen"),
        ({"both": {"log", "screen"}, "stderr": "own_log"}, "screen"),
        ({"stdout": "log", "stderr": {"own_log"}}, "log"),
        ({"stdout": "screen", "stderr": "log"}, ""),
    ],
)
def test_output_of_either_stream(prefix: Prefix, output: dict[str, object], found: str) -> None:
    text = python(f"ExecuteProcess(cmd=['true'], output={output})")
    evaluated = prefix.evaluate("a.launch.py", text)
    (process,) = processes(evaluated)
    assert process.output == found
    assert [each.what.partition(":")[0] for each in evaluated.losses] == ["output"] * (not found)


def test_a_shell(prefix: Prefix) -> None:
    text = python("ExecuteProcess(cmd=['echo', '$HOME', '&&', 'true'], shell=True)")
    (process,) = processes(prefix.evaluate("a.launch.py", text))
    assert process.shell
    assert process.command == ["echo $HOME && true"]


def test_a_debugger_and_a_shell(prefix: Prefix) -> None:
    node = "package='pkg', executable='talker', prefix='gdb -ex run --args', shell=True"
    (process,) = processes(prefix.evaluate("a.launch.py", python(f"Node({node}, name='t')")))
    assert process.shell
    assert (process.package, process.executable, process.name) == ("pkg", "talker", "t")
    assert process.prefix == ["gdb", "-ex", "run", "--args"]


def test_a_clean_environment(prefix: Prefix, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOMETHING", "1")
    text = python(
        "ExecuteProcess(cmd=['true'], env={'ONLY': '1'})",
        "SetEnvironmentVariable('NEW', '2')",
        "ExecuteProcess(cmd=['true'])",
    )
    first, second = processes(prefix.evaluate("a.launch.py", text))
    assert first.environment == [("ONLY", "1")]
    assert {"SOMETHING", "PATH"} <= set(first.unset)
    assert second.environment == [("NEW", "2")]
    assert second.unset == []


def test_the_answer_without_what_is_left_out(prefix: Prefix) -> None:
    """What launch does needlessly often changes nothing."""
    file = prefix.file("p.yaml", "/**: {ros__parameters: {a: 0x10, b: [1.5, 2], c: no, d: ~}}\n")
    prefix.file("b.launch.xml", '<launch><arg name="x" default="$(env HOME)/\\\\$d"/></launch>\n')
    text = f"""
<launch>
  <include file="{prefix.folder}/b.launch.xml"/>
  <node pkg="pkg" exec="talker" name="t" args="$(var x) a\\\\b"><param from="{file}"/></node>
  <node pkg="pkg" exec="talker" name="t" args="'it is' (plain) -1.5 )"/>
  <node_container pkg="pkg" exec="component_container" name="c" namespace="">
    <composable_node pkg="demo" plugin="demo::A" name="a">
      <param name="l" value="[a, b]"/>
    </composable_node>
  </node_container>
</launch>
"""
    assert prefix.evaluate("a.launch.xml", text) == prefix.evaluate(
        "a.launch.xml", text, is_faster=False
    )
