"""Command lines."""

from __future__ import annotations

from pathlib import Path

import pytest

from play_launch.config.model import (
    ContainerConfig,
    ContainerType,
    Isolation,
    MemoryDomains,
    OnExit,
    ProcessConfig,
)
from play_launch.config.resources import GroupLimits, Resources
from play_launch.container.command import (
    NotInPackageError,
    component_library,
    container_argv,
    find_executable,
    process_argv,
    stays_alone,
)

BINARY = Path("/opt/lib/component_container")


def container(**changes: object) -> ContainerConfig:
    values: dict[str, object] = {"name": "c", "namespace": "/", "full_name": "/c", **changes}
    return ContainerConfig(**values)  # type: ignore[arg-type]


def process(**changes: object) -> ProcessConfig:
    values: dict[str, object] = {"name": "", "namespace": "", "full_name": "/[x]", **changes}
    return ProcessConfig(**values)  # type: ignore[arg-type]


def test_a_container_with_everything() -> None:
    config = container(
        namespace="/sensing",
        container_type=ContainerType.MT,
        thread_num=4,
        log_level="debug",
        ros_arguments=("-p", "use_sim_time:=true"),
        arguments=("--failpoints", "container.drop_event=loaded"),
        core_dumps=True,
        memory_domains=MemoryDomains.REQUIRED,
    )
    # The last two are for isolated containers.
    assert container_argv(config, BINARY, stop_timeout=1.5) == (
        "/opt/lib/component_container",
        *("--use_multi_threaded_executor", "--thread_num", "4", "--stop_timeout", "1.5"),
        *("--failpoints", "container.drop_event=loaded"),
        *("--ros-args", "-r", "__node:=c", "-r", "__ns:=/sensing"),
        *("--log-level", "debug", "-p", "use_sim_time:=true"),
    )


@pytest.mark.parametrize(
    ("kind", "isolation", "flags"),
    [
        (ContainerType.STANDARD, Isolation.PROCESS, ()),
        (ContainerType.ISOLATED, Isolation.AUTO, ("--isolated", "--isolation", "auto")),
        (
            ContainerType.ISOLATED_MT,
            Isolation.SHARED_MEMORY,
            ("--isolated", "--isolation", "shared_memory", "--use_multi_threaded_executor"),
        ),
    ],
)
def test_an_isolated_container(
    kind: ContainerType, isolation: Isolation, flags: tuple[str, ...]
) -> None:
    argv = container_argv(container(container_type=kind, isolation=isolation), BINARY)
    assert argv[1 : argv.index("--ros-args")] == flags
    more = {"core_dumps": True, "memory_domains": MemoryDomains.REQUIRED}
    asked = container(container_type=kind, isolation=isolation, **more)
    added = {"--core_dumps", "--memory_domains", "required"} if flags else set()
    assert set(container_argv(asked, BINARY)) - set(argv) == added


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({}, ""),
        ({"log_level": "warn", "cwd": Path("/"), "thread_num": 3}, ""),
        ({"resources": Resources(nice=3)}, ""),
        ({"container_type": ContainerType.MT}, "do not share memory"),
        ({"container_type": ContainerType.STOCK}, "do not share memory"),
        ({"isolation": Isolation.PROCESS}, "do not share memory"),
        ({"on_exit": OnExit.SHUTDOWN}, "on_exit: shutdown"),
        ({"memory_domains": MemoryDomains.AUTO}, "memory_domains"),
        ({"resources": Resources(group=GroupLimits(pids_max=9))}, "control group"),
        ({"prefix": ("gdb",)}, "prefix"),
        ({"ros_arguments": ("-p", "a:=b")}, "ros_arguments"),
    ],
)
def test_what_keeps_a_container_alone(changes: dict[str, object], why: str) -> None:
    asked = container(**{"container_type": ContainerType.ISOLATED, **changes})
    assert why in stays_alone(asked)
    assert bool(why) is bool(stays_alone(asked))


def test_a_stock_container_gets_its_arguments_before_those_for_ros() -> None:
    config = ContainerConfig(
        name="box",
        namespace="/a",
        full_name="/a/box",
        container_type=ContainerType.STOCK,
        arguments=("--use_multi_threaded_executor",),
        log_level="warn",
        ros_arguments=("-p", "thread_num:=4"),
    )
    assert container_argv(config, Path("/x/component_container_isolated")) == (
        "/x/component_container_isolated",
        "--use_multi_threaded_executor",
        "--ros-args",
        "-r",
        "__node:=box",
        "-r",
        "__ns:=/a",
        "--log-level",
        "warn",
        "-p",
        "thread_num:=4",
    )


def test_a_node_with_everything() -> None:
    config = process(
        name="listener",
        namespace="/ns",
        package="demo",
        executable="listener",
        arguments=("--verbose",),
        remappings=(("chatter", "/talk"), ("__ns", "/other")),
        log_level="warn",
        ros_arguments=("--enclave", "/e"),
    )
    argv = process_argv(config, executable=Path("/p/listener"), parameter_file=Path("/t/p.yaml"))
    assert argv == (
        *("/p/listener", "--verbose", "--ros-args", "-r", "chatter:=/talk", "-r", "__ns:=/other"),
        *("-r", "__node:=listener", "-r", "__ns:=/ns", "--params-file", "/t/p.yaml"),
        *("--log-level", "warn", "--enclave", "/e"),
    )


def test_a_nameless_node_keeps_its_own_name() -> None:
    argv = process_argv(process(command=("node",), log_level="info"))
    assert argv == ("node", "--ros-args", "--log-level", "info")


def test_the_first_index_of_a_package_says_which_components_there_are(tmp_path: Path) -> None:
    listed = {
        ("overlay", "rclcpp_components"): "a::New;lib/libnew.so\n",
        ("underlay", "rclcpp_components"): "a::New;lib/libold.so\na::Gone;lib/libold.so\n",
        ("underlay", "packages"): "",
    }
    for (prefix, index), content in listed.items():
        folder = tmp_path / prefix / "share/ament_index/resource_index" / index
        folder.mkdir(parents=True)
        (folder / "a").write_text(content, encoding="utf-8")
    prefixes = [tmp_path / name for name in ("empty", "overlay", "underlay")]
    assert component_library("a", "a::New", prefixes) == tmp_path / "overlay/lib/libnew.so"
    with pytest.raises(NotInPackageError, match="has no component a::Gone; did you mean a::New"):
        component_library("a", "a::Gone", prefixes)


def test_executables_are_found_in_the_first_prefix(tmp_path: Path) -> None:
    prefixes = [tmp_path / name for name in ("empty", "not executable", "first", "second")]
    for prefix in prefixes[1:]:
        folder = prefix / "lib" / "demo"
        folder.mkdir(parents=True)
        (folder / "listener").touch(0o644 if prefix.name == "not executable" else 0o755)
    found = find_executable("demo", "listener", prefixes)
    assert found == tmp_path / "first" / "lib" / "demo" / "listener"
    with pytest.raises(NotInPackageError, match="demo has no executable listner; did you mean lis"):
        find_executable("demo", "listner", prefixes)
    with pytest.raises(NotInPackageError, match=r"demo has no executable talker; it has listener$"):
        find_executable("demo", "talker", prefixes)
    with pytest.raises(NotInPackageError, match="package other is not installed: no prefix"):
        find_executable("other", "talker", prefixes)
