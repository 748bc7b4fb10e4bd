"""A system as large as a small Autoware, in the two formats of the program play_launch (Rust)."""

from __future__ import annotations

from typing import Any

CONTAINERS = 15
PER_CONTAINER = 3


def nodes(*, stand_in: bool) -> list[dict[str, Any]]:
    """Return neutral nodes; with `stand_in` of packages that are installed with the tests."""
    package = "play_launch_demo" if stand_in else "autoware_component"
    plugin = "play_launch_demo::Echo" if stand_in else "autoware::component::Node"
    found: list[dict[str, Any]] = []
    for number in range(CONTAINERS):
        namespace = f"/area_{number % 4}"
        container = f"{namespace}/container_{number}"
        program = "component_container_mt" if number % 3 == 0 else "component_container"
        found.append({"kind": "container", "name": container, "program": program})
        found.extend(
            {
                "kind": "composable",
                "name": f"{namespace}/node_{number}_{each}",
                "container": container,
                "package": package,
                "plugin": plugin,
                "params": [("rate", "10.0"), ("use_sim_time", "false"), ("gains", "[1.0, 2]")],
                "remaps": [("chatter", f"/area/lane_{number}")],
            }
            for each in range(PER_CONTAINER)
        )
    executable = "tiny_node" if stand_in else "node"
    monitor = {"kind": "node", "name": "/system/monitor", "package": package}
    found.append({**monitor, "executable": executable})
    return found


def _split(name: str) -> tuple[str, str]:
    namespace, _, last = name.rpartition("/")
    return namespace, last


def launch_dump(*, stand_in: bool) -> dict[str, Any]:
    """Return it as a record.json."""
    dump: dict[str, Any] = {
        "container": [],
        "file_data": {},
        "lifecycle_node": [],
        "load_node": [],
        "node": [],
        "variables": {"speed": "fast"},
    }
    process = {"cmd": [], "params": [], "params_files": [], "remaps": [], "exec_name": "x-1"}
    for node in nodes(stand_in=stand_in):
        namespace, name = _split(node["name"])
        if node["kind"] == "composable":
            dump["load_node"].append(
                {
                    "package": node["package"],
                    "plugin": node["plugin"],
                    "target_container_name": node["container"],
                    "node_name": name,
                    "namespace": namespace,
                    "params": [list(each) for each in node["params"]],
                    "remaps": [list(each) for each in node["remaps"]],
                    "extra_args": {"use_intra_process_comms": "True"},
                    "log_level": None,
                    "env": None,
                }
            )
            continue
        is_container = node["kind"] == "container"
        record = {**process, "name": name, "namespace": namespace, "respawn": True}
        record["package"] = "rclcpp_components" if is_container else node["package"]
        record["executable"] = node["program"] if is_container else node["executable"]
        dump["container" if is_container else "node"].append(record)
    return dump


def system_model(*, stand_in: bool) -> dict[str, Any]:
    """Return it as a system_model.yaml."""
    structure: dict[str, Any] = {}
    for node in nodes(stand_in=stand_in):
        _, name = _split(node["name"])
        common = {"scope": "autoware_launch/planning.launch.xml", "node_name": name}
        if node["kind"] == "composable":
            structure[node["name"]] = {
                **common,
                "pkg": node["package"],
                "plugin": node["plugin"],
                "container": node["container"],
                "params": {"rate": 10.0, "use_sim_time": False, "gains": "[1.0, 2]"},
                "remaps": [{"from": one, "to": other} for one, other in node["remaps"]],
                "extra_args": {"use_intra_process_comms": "True"},
            }
        elif node["kind"] == "container":
            structure[node["name"]] = {
                **common,
                "pkg": "rclcpp_components",
                "exec": node["program"],
                "is_container": True,
                "respawn": True,
            }
        else:
            structure[node["name"]] = {
                **common,
                "pkg": node["package"],
                "exec": node["executable"],
                "respawn": True,
            }
    return {"meta": {"version": 1}, "structure": {"scopes": {}, "nodes": structure}}
