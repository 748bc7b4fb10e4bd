"""Launch files with something in them that is easily evaluated in another way than ROS does it."""

from __future__ import annotations

TRAPS: dict[str, dict[str, str]] = {
    # An include does not scope, a group does; what is pushed in an included file stays.
    "scopes": {
        "a.launch.xml": """
<launch>
  <arg name="x" default="outer"/>
  <include file="$(dirname)/b.launch.xml"><arg name="y" value="given"/></include>
  <node pkg="pkg" exec="talker" name="one" args="$(var x) $(var y) $(var z)"/>
  <group>
    <let name="x" value="inner"/>
    <node pkg="pkg" exec="talker" name="two" args="$(var x)"/>
  </group>
  <node pkg="pkg" exec="talker" name="three" args="$(var x)"/>
  <group scoped="false"><let name="x" value="leaks"/></group>
  <node pkg="pkg" exec="talker" name="four" args="$(var x)"/>
  <group scoped="$(var no)"><let name="x" value="a text counts as true"/></group>
  <node pkg="pkg" exec="talker" name="five" args="$(var x)"/>
</launch>""",
        "b.launch.xml": """
<launch>
  <arg name="x" default="never"/>
  <let name="z" value="$(var x)-$(var y)"/>
  <let name="no" value="false"/>
  <push_ros_namespace namespace="pushed"/>
</launch>""",
    },
    # $(dirname) after an include is that of the included file, also for its arguments.
    "folders": {
        "a.launch.xml": """
<launch>
  <node pkg="pkg" exec="talker" name="one" args="$(dirname) $(filename)"/>
  <include file="$(dirname)/below/b.launch.yaml"><arg name="where" value="$(dirname)"/></include>
  <node pkg="pkg" exec="talker" name="two" args="$(dirname) $(var where)"/>
</launch>""",
        "below/b.launch.yaml": """
launch:
- arg: {name: where}
- node: {pkg: pkg, exec: listener, name: b, args: "$(dirname)"}
""",
    },
    # let is evaluated at once.
    "let": {
        "a.launch.xml": """
<launch>
  <arg name="x" default="1"/>
  <let name="y" value="$(var x)"/>
  <let name="x" value="2"/>
  <node pkg="pkg" exec="talker" args="$(var y) $(var x) $(var nothing default) $(env HOME)"/>
</launch>""",
    },
    # A global parameter in a group leaks out if there was one before.
    "global parameters": {
        "a.launch.xml": """
<launch>
  <group>
    <set_parameter name="first" value="1"/>
    <node pkg="pkg" exec="talker" name="one"/>
  </group>
  <node pkg="pkg" exec="talker" name="two"/>
  <set_parameter name="use_sim_time" value="true"/>
  <group>
    <set_parameter name="leaks" value="[1, 2]"/>
    <set_parameter name="text" value="'5'"/>
    <set_remap from="a" to="b"/>
    <node_container pkg="pkg" exec="component_container" name="c" namespace="">
      <composable_node pkg="pkg" plugin="p::C" name="in_c"/>
    </node_container>
  </group>
  <node pkg="pkg" exec="talker" name="three"><param name="leaks" value="9"/></node>
</launch>""",
    },
    # Composable nodes have the namespace of where they stand, not that of their container.
    "composables": {
        "a.launch.xml": """
<launch>
  <group>
    <push_ros_namespace namespace="robot"/>
    <set_remap from="chatter" to="first"/>
    <node_container pkg="pkg" exec="component_container" name="c" namespace="/far">
      <composable_node pkg="pkg" plugin="p::C" name="one">
        <remap from="chatter" to="second"/>
        <param name="a.b" value="1"/>
        <extra_arg name="use_intra_process_comms" value="true"/>
      </composable_node>
      <composable_node pkg="pkg" plugin="p::C" name="two" namespace="below" unless="false"/>
      <composable_node pkg="pkg" plugin="p::C" name="not" if="0"/>
    </node_container>
  </group>
  <load_composable_node target="/far/c">
    <composable_node pkg="pkg" plugin="p::D" name="three" namespace="x/"/>
  </load_composable_node>
</launch>""",
    },
    "types": {
        "a.launch.xml": """
<launch>
  <let name="five" value="5"/>
  <node pkg="pkg" exec="talker" name="n" namespace="ns">
    <param name="octal" value="010"/>
    <param name="clock" value="10:30"/>
    <param name="word" value="yes"/>
    <param name="power" value="1e3"/>
    <param name="real_power" value="1.0e+3"/>
    <param name="quoted" value="'5'"/>
    <param name="double_quoted" value="'&quot;5&quot;'"/>
    <param name="text" value="5" type="str"/>
    <param name="double" value="5" type="float"/>
    <param name="of_variable" value="$(var five)"/>
    <param name="text_of_variable" value="$(var five)" type="str"/>
    <param name="list" value="[$(var five), 6]"/>
    <param name="separated" value="a;b" value-sep=";"/>
    <param name="texts" value="1,2" value-sep="," type="list_of_str"/>
    <param name="empty" value=""/>
    <param name="nested">
      <param name="a" value="1.5"/>
      <param name="b"><param name="c" value="off"/></param>
    </param>
    <param name="escaped" value="\\$(var five)"/>
    <param name="ys" value="['y', 'y']"/>
  </node>
  <node_container pkg="pkg" exec="component_container" name="c" namespace="">
    <composable_node pkg="pkg" plugin="p::C" name="d">
      <param name="power" value="1e3"/>
      <param name="octal" value="010"/>
      <param name="y" value="y"/>
    </composable_node>
  </node_container>
</launch>""",
        "b.launch.yaml": """
launch:
- node:
    pkg: pkg
    exec: talker
    param:
    - {name: number, value: 5}
    - {name: text, value: "5"}
    - {name: list, value: [1.5, 2.5]}
    - {name: word, value: yes}
    - {name: typed, value: "$(eval '1 + 1')"}
    - name: nested
      param:
      - {name: deep, value: x}
""",
    },
    # Sections count where they are mentioned first; the values of a launch file have a section too.
    "order of sources": {
        "a.launch.xml": """
<launch>
  <node pkg="pkg" exec="talker" name="n" namespace="/">
    <param name="a" value="1"/>
    <param from="$(dirname)/all.yaml"/>
    <param name="a" value="3"/>
  </node>
  <node pkg="pkg" exec="talker" name="m" namespace="/">
    <param from="$(dirname)/all.yaml"/>
    <param name="a" value="1"/>
    <param from="$(dirname)/all.yaml"/>
  </node>
  <node pkg="pkg" exec="talker">
    <param from="$(dirname)/all.yaml"/>
    <param name="a" value="1"/>
  </node>
  <node pkg="pkg" exec="talker" name="s" namespace="/">
    <param from="$(dirname)/filled.yaml" allow_substs="true"/>
  </node>
  <node_container pkg="pkg" exec="component_container" name="c" namespace="">
    <composable_node pkg="pkg" plugin="p::C" name="one" namespace="/ns">
      <param name="a" value="1"/>
      <param from="$(dirname)/all.yaml"/>
    </composable_node>
  </node_container>
</launch>""",
        "all.yaml": """
/**: {ros__parameters: {a: 2, word: yes, n: 0x10, b: {c: 1.0}}}
/n: {ros__parameters: {own: 1}}
ns: {one: {ros__parameters: {own: 2}}}
/*/one: {ros__parameters: {star: 2}}
/other: {ros__parameters: {x: [1, 2]}}
""",
        "filled.yaml": '/**: {ros__parameters: {home: $(env HOME), folder: "$(dirname)"}}\n',
    },
    # What a timer starts is evaluated when it fires: its group has ended.
    "timers": {
        "a.launch.xml": """
<launch>
  <let name="x" value="1"/>
  <group>
    <push_ros_namespace namespace="inner"/>
    <let name="x" value="2"/>
    <timer period="2.5">
      <node pkg="pkg" exec="talker" name="later" args="$(var x)"/>
      <timer period="1"><executable cmd="echo $(var x)"/></timer>
    </timer>
    <node pkg="pkg" exec="talker" name="now" args="$(var x)"/>
  </group>
</launch>""",
    },
    # They fire in the order of their times, not in that in which they stand there.
    "order of timers": {
        "a.launch.xml": """
<launch>
  <timer period="3.0"><let name="x" value="set"/><executable cmd="b $(var x)"/></timer>
  <timer period="1.0" cancel_on_shutdown="false"><executable cmd="a $(var x not)"/></timer>
</launch>""",
    },
    "environment": {
        "a.launch.xml": """
<launch>
  <set_env name="A" value="1"/>
  <group>
    <set_env name="A" value="2"/>
    <append_env name="A" value="3"/>
    <append_env name="B" value="4" prepend="true" separator="-"/>
    <append_env name="B" value="5" prepend="true" separator="-"/>
    <let name="x" value="$(env A)"/>
    <let name="y" value="1"/>
    <node pkg="pkg" exec="talker" name="one"><env name="C" value="$(env B)"/></node>
    <group scoped="true" forwarding="false">
      <keep name="kept" value="$(var x)"/>
      <executable cmd="echo $(env A none) $(var kept) $(var y gone)"/>
    </group>
  </group>
  <unset_env name="A"/>
  <unset_env name="PATH"/>
  <executable cmd="echo $(env A 'not set')"/>
</launch>""",
    },
    "command lines": {
        "a.launch.xml": """
<launch>
  <let name="two" value="one two"/>
  <executable name="e"
    cmd="echo $(var two) 'a b'$(var two) $(var two)$(var two) --x=$(var two) end"/>
  <executable cmd="echo $HOME | cat" shell="true" cwd="/tmp" output="screen" emulate_tty="true"/>
  <node pkg="pkg" exec="talker" args="-d $(dirname)/x.rviz   -y" ros_args="--log-level debug"
        launch-prefix="nice -n '5'" respawn="1" respawn_delay="2" respawn_max_retries="3"
        sigterm_timeout="7" sigkill_timeout="8.5" on_exit="shutdown" exec_name="label"/>
</launch>""",
    },
    "substitutions": {
        "a.launch.xml": """
<launch>
  <let name="a" value="5"/>
  <let name="b" value="$(eval '$(var a) * 2 + 0.5')"/>
  <let name="c" value="$(eval '&quot;$(var a)&quot; == &quot;5&quot; and not (1 > 2)')"/>
  <let name="d" value="$(if $(equals $(var a) 5.0) yes no)$(not-equals a b)$(not true)"/>
  <let name="e" value="$(and true 1)$(or false off)"/>
  <let name="f" value="$(command 'echo two words')$(file-content $(dirname)/x.txt)"/>
  <let name="g" value="$(find-pkg-share pkg) $(find-pkg-prefix pkg) $(exec-in-pkg talker pkg)"/>
  <let name="h" value="$(eval 'math.floor(pi) if &quot;a&quot;.upper() == &quot;A&quot; else 0')"/>
  <set_parameter name="p" value="x"/>
  <let name="i" value="$(param p) a\\b $5 (x) $(var 'a')"/>
  <node pkg="pkg" exec="talker" if="$(eval '1 == 1')">
    <param name="x" type="str"
      value="$(var b)|$(var c)|$(var d)|$(var e)|$(var f)|$(var g)|$(var h)|$(var i)"/>
  </node>
</launch>""",
        "x.txt": "text",
    },
    "log folder": {
        "a.launch.xml": """
<launch>
  <node pkg="pkg" exec="talker" args="$(log_dir)/x"/>
  <set_env name="ROS_LOG_DIR" value="/logs"/>
  <node pkg="pkg" exec="listener" args="$(launch_log_dir)"/>
</launch>""",
    },
}

MISTAKES: dict[str, tuple[str, str]] = {
    # name: (text, what the error says after the path)
    "tag": ("<launch>\n<nod/></launch>", ":2: launch has no nod; did you mean node?"),
    "attribute": (
        '<launch><node pkg="pkg" exec="talker"\n nam="x"/></launch>',
        ":1: node has no attribute nam; did you mean name?",
    ),
    "missing attribute": (
        "<launch>\n<let name='x'/></launch>",
        ":2: let needs the attribute value",
    ),
    "in what is not wanted": (
        '<launch>\n<group if="false">\n<node/></group></launch>',
        ":3: node needs the attribute exec",
    ),
    "nested": (
        '<launch><let name="x" value="1">\n<arg name="x"/></let></launch>',
        ":2: let cannot hold arg",
    ),
    "condition": (
        '<launch>\n\n<log message="x" if="maybe"/></launch>',
        ":3: 'maybe' is no condition",
    ),
    "both conditions": ('<launch><log message="x" if="1" unless="1"/></launch>', "if or unless"),
    "variable": (
        '<launch>\n<log message="$(var x)"/></launch>',
        ":2: there is no launch argument or variable x",
    ),
    "argument": ('<launch>\n<arg name="x"/></launch>', ":2: the argument x is required"),
    "choice": (
        '<launch><arg name="x" default="3"><choice value="1"/><choice value="2"/></arg></launch>',
        "'3' is none of the choices of x: 1, 2",
    ),
    "substitution": ('<launch><log message="$(nothing)"/></launch>', "no substitution $(nothing)"),
    "grammar": ('<launch><log message="$(var x"/></launch>', "a substitution is not closed"),
    "environment": ('<launch><log message="$(env NO_X)"/></launch>', "NO_X is not set"),
    "package": (
        '<launch><log message="$(find-pkg-share no_such)"/></launch>',
        "no package no_such is installed",
    ),
    "node of no package": (
        '<launch>\n<node pkg="no_such" exec="talker"/></launch>',
        ":2: no package no_such is installed",
    ),
    "no such program": (
        '<launch>\n<node pkg="pkg" exec="no_such"/></launch>',
        ":2: there is no executable no_such in ",
    ),
    "evaluation": (
        """<launch><log message="$(eval '1 +')"/></launch>""",
        "$(eval '1 +'): invalid syntax",
    ),
    "code": (
        """<launch><log message="$(eval '__import__(0)')"/></launch>""",
        "__import__ is not defined here",
    ),
    "command": (
        """<launch><log message="$(command 'false')"/></launch>""",
        "'false' exited with 1",
    ),
    "no command": (
        """<launch><log message="$(command 'no-such-program x')"/></launch>""",
        "cannot be run",
    ),
    "xml": ("<launch>\n<node>\n</launch>", ":3: is not XML: mismatched tag"),
    "no xml": ("", "is not XML"),
    "root": ("<robot/>", ":1: expected launch at the top, given robot"),
    "file": (
        '<launch>\n<include file="$(dirname)/missing.launch.xml"/></launch>',
        ":2: the launch file",
    ),
    "itself": (
        '<launch><include file="$(filename)"/></launch>',
        "includes are nested deeper than",
    ),
    "python": (
        '<launch>\n<include file="$(dirname)/x.launch.py"/></launch>',
        "is a launch file in Python, which needs ROS's own launch and launch_ros",
    ),
    "mixed list": (
        '<launch><node pkg="p" exec="e">\n<param name="x" value="[1, 2.5]"/></node></launch>',
        ":2: ",
    ),
    "no value": (
        '<launch><node pkg="p" exec="e"><param name="x" value="null"/></node></launch>',
        "neither a value nor a list",
    ),
    "wrong type": (
        '<launch><node pkg="p" exec="e"><param name="x" type="int" value="x"/></node></launch>',
        "'x' is no int",
    ),
    "namespace": (
        '<launch><push_ros_namespace namespace="a b"/></launch>',
        "'/a b' is no namespace",
    ),
    "node name": ('<launch><node pkg="p" exec="e" name="a/b"/></launch>', "not the name of a node"),
    "output": (
        '<launch>\n<executable cmd="x" output="scren"/></launch>',
        ":2: 'scren' is no output",
    ),
    "on exit": ('<launch><node pkg="p" exec="e" on_exit="x"/></launch>', "can only be shutdown"),
}
