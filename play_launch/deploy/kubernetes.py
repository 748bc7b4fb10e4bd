"""Kubernetes manifests of a system: a pod for each machine, on the node with its label."""

from __future__ import annotations

import math
import os
import re
from typing import TYPE_CHECKING, Any, Final

import yaml
from msgspec import Struct

from play_launch.config.dependency import ABOUT_GRAPH
from play_launch.config.machines import DiscoveryBy, part_of, used_machines
from play_launch.deploy.machines.bundle import files_of
from play_launch.deploy.machines.hosts import HostError
from play_launch.deploy.unit import stop_seconds

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from play_launch.config.model import ReplayConfig

    _Items = dict[str, dict[str, str]]
    """By path: the key in the ConfigMap, and the path below the mounted folder."""

_LARGEST: Final = 900_000
"""Bytes in a ConfigMap, of which etcd takes 1 MiB."""
_FOLDER: Final = "/etc/play_launch"
_RECORDINGS: Final = "/var/log/play_launch"
_LABEL: Final = "play-launch/machine"
"""Of nodes: the machine that runs there."""
_PART_OF: Final = "app.kubernetes.io/part-of"
_NAME: Final = "app.kubernetes.io/name"
_SPARE: Final = 5
"""Seconds from the end of an orderly stop to SIGKILL."""
_START_LIMIT: Final = 60
"""Seconds until the supervisor answers, on a cold disk."""
_LOADING: Final = 300
"""Seconds for a start, downloads of models included."""
_PERIOD: Final = 10
"""Seconds between probes: each takes 0.1 s of CPU time."""


class Workload(Struct, frozen=True, kw_only=True):
    """What to write besides the configuration."""

    image: str
    arguments: Sequence[str] = ()
    """Of the configuration, ``name:=value``."""
    fleet: bool = False
    """Whether each node with the label runs the machine (DaemonSet)."""


def manifests(config: ReplayConfig, workload: Workload) -> str:
    """Write a ConfigMap and a workload for each machine; raises HostError with the fix."""
    names: list[str] = used_machines(config) if config.machines else [""]
    parts = {name: part_of(config, name) if name else config for name in names}
    _refuse_conditions(parts)
    if len(parts) > 1 and config.discovery is DiscoveryBy.PEERS:
        raise HostError(
            "discovery by peers needs the coordinator, which pods do not have: use multicast, or "
            "set ROS_STATIC_PEERS in environment"
        )
    if workload.fleet and config.duration is not None:
        raise HostError("duration makes a Job of it, which is no DaemonSet: leave one of them out")
    files = files_of(config, [path for each in config.machines.values() for path in each.copy])
    items = _items(files)
    documents: list[dict[str, Any]] = [_config_map(config, files, items)]
    documents += [_workload(config, part, workload, name, items) for name, part in parts.items()]
    return yaml.safe_dump_all(documents, sort_keys=False, default_flow_style=False, width=100)


def kustomization(config: ReplayConfig, image: str) -> dict[str, str]:
    """Write, by file name, an overlay in which image and namespace are changed."""
    name, separator, tag = image.rpartition(":")
    if not separator or "/" in tag:  # the colon is that of a registry's port
        name, tag = image, "latest"
    if "@" in image:
        raise HostError(f"--image {image}: give a tag, no digest, for the overlay")
    overlay: dict[str, Any] = {
        "apiVersion": "kustomize.config.k8s.io/v1beta1",
        "kind": "Kustomization",
        "namespace": _plain(config.name),
        "resources": ["namespace.yaml", "system.yaml"],
        "images": [{"name": name, "newName": name, "newTag": tag}],
    }
    # kustomize gives it the name of the overlay's namespace.
    namespace = {
        "apiVersion": "v1",
        "kind": "Namespace",
        "metadata": {"name": _plain(config.name)},
    }
    written = {"namespace.yaml": namespace, "kustomization.yaml": overlay}
    return {name: yaml.safe_dump(each, sort_keys=False) for name, each in written.items()}


def _refuse_conditions(parts: dict[str, ReplayConfig]) -> None:
    """Refuse conditions that a coordinator would have to report from another machine."""
    for part in parts.values():
        for unit, rule in part.start_rules.items():
            for each in rule.dependencies:
                if each.machine and each.condition not in ABOUT_GRAPH:
                    raise HostError(
                        f"{unit} waits for {each}, and pods do not know each other's state: wait "
                        "for a topic, service or node of it in depends_on"
                    )


def _config_map(config: ReplayConfig, files: Mapping[str, bytes], items: _Items) -> dict[str, Any]:
    size = sum(map(len, files.values()))
    if size > _LARGEST:
        raise HostError(
            f"the files of the configuration have {size} bytes, and a ConfigMap takes {_LARGEST}: "
            "move maps and the like into the image, or onto a volume"
        )
    data: dict[str, str] = {}
    for path, item in items.items():
        try:
            data[item["key"]] = files[path].decode()
        except UnicodeDecodeError:
            raise HostError(f"{path} is no text: move it into the image") from None
    return {
        "apiVersion": "v1",
        "kind": "ConfigMap",
        "metadata": {"name": _plain(config.name), "labels": {_PART_OF: _plain(config.name)}},
        "data": data,
    }


def _items(files: Iterable[str]) -> _Items:
    """Give each file its place in the ConfigMap and in the pod."""
    top = os.path.commonpath([os.path.dirname(path) for path in files])  # noqa: PTH120
    found: dict[str, dict[str, str]] = {}
    for path in sorted(files):
        below = os.path.relpath(path, top)
        # The key stays the same when other files come and go: pods see each change of it.
        key = re.sub("[^-._a-zA-Z0-9]+", "_", below)
        while any(key == each["key"] for each in found.values()):
            key += "_"
        found[path] = {"key": key, "path": below}
    return found


def _workload(
    config: ReplayConfig, part: ReplayConfig, workload: Workload, machine: str, items: _Items
) -> dict[str, Any]:
    name = _plain(f"{config.name}-{machine}" if machine else config.name)
    labels = {_NAME: name, _PART_OF: _plain(config.name)}
    template = {
        "metadata": {"labels": labels},
        "spec": _pod(config, part, workload, machine, items),
    }
    metadata = {"name": name, "labels": labels}
    if config.duration is not None:
        template["spec"]["restartPolicy"] = "Never"
        limit = math.ceil(config.duration) + _LOADING + stop_seconds(part)
        spec = {"backoffLimit": 0, "activeDeadlineSeconds": limit, "template": template}
        return {"apiVersion": "batch/v1", "kind": "Job", "metadata": metadata, "spec": spec}
    selector = {"matchLabels": {_NAME: name}}
    if workload.fleet:
        spec = {"selector": selector, "template": template}
        return {"apiVersion": "apps/v1", "kind": "DaemonSet", "metadata": metadata, "spec": spec}
    # Two instances of a node must never run at once.
    spec = {
        "replicas": 1,
        "strategy": {"type": "Recreate"},
        "selector": selector,
        "template": template,
    }
    return {"apiVersion": "apps/v1", "kind": "Deployment", "metadata": metadata, "spec": spec}


def _pod(
    config: ReplayConfig, part: ReplayConfig, workload: Workload, machine: str, items: _Items
) -> dict[str, Any]:
    source = f"{_FOLDER}/{items[str(config.source.absolute())]['path']}"
    # Of a changed ConfigMap only what differs is applied.
    words = ["play-launch", "replay", "--quiet", "--watch"]
    words += ["--machine", machine] if machine else []
    container: dict[str, Any] = {
        "name": "play-launch",
        "image": workload.image,
        "command": [*words, source, *workload.arguments],
        "env": [
            {"name": "HOME", "value": "/tmp"},  # noqa: S108 - ROS writes its log files there
            {"name": "PLAY_LAUNCH_LOG_DIR", "value": _RECORDINGS},
        ],
        "readinessProbe": {
            "exec": {"command": ["play-launch", "wait", "--for", "loaded", "--timeout", "1s"]},
            "periodSeconds": _PERIOD,
            "timeoutSeconds": 5,
        },
        # A node that cannot be loaded must not restart the others: only the supervisor is asked.
        "livenessProbe": {
            "exec": {"command": ["play-launch", "ps"]},
            "initialDelaySeconds": _START_LIMIT,
            "periodSeconds": 3 * _PERIOD,
            "timeoutSeconds": _PERIOD,
        },
        "volumeMounts": [
            {"name": "config", "mountPath": _FOLDER, "readOnly": True},
            {"name": "shared-memory", "mountPath": "/dev/shm"},  # noqa: S108
            {"name": "recordings", "mountPath": _RECORDINGS},
        ],
    }
    if config.duration is not None:
        del container["readinessProbe"], container["livenessProbe"]
    if _asks_for_priorities(part):
        container["securityContext"] = {"capabilities": {"add": ["SYS_NICE"]}}
    # Two pods of a system on one node would not share /dev/shm, and Fast DDS, which takes them for
    # one host, would deliver nothing between them.
    apart = {
        "labelSelector": {"matchLabels": {_PART_OF: _plain(config.name)}},
        "topologyKey": "kubernetes.io/hostname",
    }
    return {
        "hostNetwork": True,
        "dnsPolicy": "ClusterFirstWithHostNet",
        **({"nodeSelector": {_LABEL: machine}} if machine else {}),
        "affinity": {
            "podAntiAffinity": {"requiredDuringSchedulingIgnoredDuringExecution": [apart]}
        },
        # A robot goes on without its control plane.
        "tolerations": [
            {"key": f"node.kubernetes.io/{why}", "operator": "Exists", "effect": "NoExecute"}
            for why in ("unreachable", "not-ready")
        ],
        "terminationGracePeriodSeconds": stop_seconds(part) + _SPARE,
        "containers": [container],
        "volumes": [
            {
                "name": "config",
                "configMap": {"name": _plain(config.name), "items": [*items.values()]},
            },
            {"name": "shared-memory", "emptyDir": {"medium": "Memory"}},
            {
                "name": "recordings",
                "hostPath": {"path": _RECORDINGS, "type": "DirectoryOrCreate"},
            },
        ],
    }


def _asks_for_priorities(part: ReplayConfig) -> bool:
    every = [each.resources for each in part.members]
    every += [node.resources for each in part.containers for node in each.composable_nodes]
    return any(
        each.scheduler is not None or (each.nice is not None and each.nice < 0) for each in every
    )


def _plain(name: str) -> str:
    """Return a name as Kubernetes has them (RFC 1123)."""
    return re.sub("[^a-z0-9]+", "-", name.lower()).strip("-")[:63].strip("-") or "system"
