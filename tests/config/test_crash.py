"""What holds for a node that crashes: the nearest word counts, each key for itself."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from play_launch.config.description import describe
from play_launch.config.load import parse_config
from play_launch.config.model import (
    ContainerConfig,
    ContainerType,
    Isolation,
    MemoryDomains,
    OnCrash,
    RestartLimits,
)
from play_launch.config.problems import ConfigError

TEXT = """
version: 1
composable_node_loading:
  container_type: isolated
  isolation: shared_memory
  thread_num: 3
  auto_reload_on_crash: false
  restart: {max_restarts: 7, within: 2 min}
containers:
  - name: inherits
    composable_nodes:
      - {package: demo, plugin: "demo::A"}
      - {package: demo, plugin: "demo::A", auto_reload_on_crash: true}
      - {package: demo, plugin: "demo::A", on_crash: shutdown, auto_reload_on_crash: false}
  - name: own
    container_type: isolated_mt
    isolation: process
    on_crash: stop_container
    restart: {max_restarts: 1}
    composable_nodes:
      - {package: demo, plugin: "demo::A"}
      - {package: demo, plugin: "demo::A", auto_reload_on_crash: false}
      - {package: demo, plugin: "demo::A", on_crash: reload, restart: {backoff: {initial: 1 s}}}
  - name: shared
    container_type: standard
    composable_nodes:
      - {package: demo, plugin: "demo::A"}
"""


@pytest.fixture(scope="module")
def containers() -> tuple[ContainerConfig, ...]:
    return parse_config(TEXT.encode(), Path("demo.yaml")).containers


def test_the_nearest_word_holds(containers: tuple[ContainerConfig, ...]) -> None:
    inherits, own, shared = containers
    assert [node.on_crash for node in inherits.composable_nodes] == [
        OnCrash.IGNORE,
        OnCrash.RELOAD,
        OnCrash.SHUTDOWN,
    ]
    assert [node.on_crash for node in own.composable_nodes] == [
        OnCrash.STOP_CONTAINER,
        OnCrash.IGNORE,
        OnCrash.RELOAD,
    ]
    assert [node.on_crash for node in shared.composable_nodes] == [OnCrash.IGNORE]


def test_restart_limits_are_refined_key_by_key(containers: tuple[ContainerConfig, ...]) -> None:
    inherits, own, _ = containers
    assert {node.restart for node in inherits.composable_nodes} == {
        RestartLimits(7, 120.0, 0.1, 30.0)
    }
    assert own.restart == RestartLimits(1, 120.0, 0.1, 30.0)
    assert own.composable_nodes[2].restart == RestartLimits(1, 120.0, 1.0, 30.0)


def test_isolation_and_threads(containers: tuple[ContainerConfig, ...]) -> None:
    assert [(one.container_type, one.isolation, one.thread_num) for one in containers] == [
        (ContainerType.ISOLATED, Isolation.SHARED_MEMORY, None),
        (ContainerType.ISOLATED_MT, Isolation.PROCESS, 3),
        (ContainerType.STANDARD, Isolation.SHARED_MEMORY, None),
    ]


@pytest.mark.parametrize("key", ["core_dumps", "consolidate"])
def test_they_are_asked_for_all_containers_and_for_one(key: str) -> None:
    text = f"""
version: 1
composable_node_loading: {{container_type: isolated, {key}: true}}
containers:
  - name: one
  - name: two
    {key}: false
"""
    for text_, wanted in ((text, [True, False]), (text.replace("true", "false"), [False, False])):
        config = parse_config(text_.encode(), Path("demo.yaml"))
        assert [getattr(one, key) for one in config.containers] == wanted


def test_memory_domains_are_asked_for() -> None:
    text = b"""
version: 1
composable_node_loading: {container_type: isolated, memory_domains: required}
containers:
  - name: one
  - name: two
    memory_domains: off
  - name: three
    container_type: standard
"""
    config = parse_config(text, Path("demo.yaml"))
    domains = [one.memory_domains for one in config.containers]
    assert domains == [MemoryDomains.REQUIRED, MemoryDomains.OFF, MemoryDomains.REQUIRED]
    assert (
        parse_config(text.replace(b", memory_domains: required", b""), Path("demo.yaml"))
        .containers[0]
        .memory_domains
        is MemoryDomains.OFF
    )
    with pytest.raises(ConfigError, match="memory_domains is for container_type isolated"):
        parse_config(text + b"    memory_domains: auto\n", Path("demo.yaml"))


def test_by_default_a_node_is_reloaded() -> None:
    text = b"""
version: 1
containers:
  - name: main
    container_type: isolated
    composable_nodes: [{package: demo, plugin: "demo::A"}]
"""
    (main,) = parse_config(text, Path("demo.yaml")).containers
    assert main.isolation is Isolation.AUTO
    assert main.composable_nodes[0].on_crash is OnCrash.RELOAD
    assert main.composable_nodes[0].restart == RestartLimits()


def test_the_description_tells_it() -> None:
    described = json.loads(json.dumps(describe(parse_config(TEXT.encode(), Path("demo.yaml")))))
    assert described["containers"][1]["isolation"] == "process"
    node = described["containers"][1]["composable_nodes"][2]
    assert node["on_crash"] == "reload"
    assert node["restart"]["backoff"]["initial"] == 1.0
