"""Systemd unit of a system: a template, and the values in it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import astuple

from play_launch.config.dependency import DependencyGraph
from play_launch.config.resources import nice_limit
from play_launch.process.stop import StopPolicy
from play_launch.recording.environment import is_secret

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from play_launch.config.model import ReplayConfig

_VARIABLES: Final = frozenset({"LD_LIBRARY_PATH", "PATH", "PYTHONPATH", "TZ"})
_PREFIXES: Final = (
    *("AMENT_", "CUDA_", "CYCLONEDDS_", "FASTDDS_", "FASTRTPS_", "GZ_", "OMP_", "PLAY_LAUNCH_"),
    *("RCL_", "RCUTILS_", "RMW_", "ROS_", "SKIP_DEFAULT_XML", "ZENOH_"),
)
"""Of ROS's setup files, the middlewares, and play-launch."""
_CLOSING_TIME: Final = 10.0
"""Seconds to clean up and to close the recording."""
_OPEN_FILES: Final = 524288
_OWN_PRIORITY: Final = 1
"""Real-time priority of the supervisor while it starts processes."""
_RESTRICTED: Final = ("memlock", "msgqueue", "nproc", "sigpending")
"""Limits with a finite default."""
_MAIN_PID: Final = "$MAINPID"
_ESCAPES: Final = {"\\": "\\\\", '"': '\\"', "\n": "\\n", "\t": "\\t"}
_PLAIN: Final = frozenset("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789/._-+:=,@")

_UNIT: Final = """\
# {name}: a system of play-launch. To install the unit:
#   cp {unit}.service {place}/ && {systemctl} daemon-reload && {systemctl} enable --now {unit}
# Generate it again when `stop`, `depends_on` or `resources` of the configuration, or the
# environment, change.
# Explanations: docs/service.md.

[Unit]
Description={description} (play-launch)
{network}StartLimitIntervalSec=300
StartLimitBurst=5

[Service]
Type=notify
NotifyAccess=main
{user}WorkingDirectory={folder}
ExecStart={start}
ExecReload={reload}
{environment}# From a cold start to the first WATCHDOG=1; play-launch extends the time from then on.
TimeoutStartSec=120
WatchdogSec=30
# SIGTERM goes to play-launch alone, which stops the rest in order, within this time.
KillMode=mixed
TimeoutStopSec={stop}
# 128+n: stopped by a signal; 2: invalid configuration.
Restart=on-failure
RestartSec=2
SuccessExitStatus=129 130 143
RestartPreventExitStatus=2
Delegate=yes
OOMPolicy=continue
# What `resources` request; a user's manager lowers them to its own (user@.service).
{limits}TasksMax=infinity

[Install]
WantedBy={target}
"""
_LEFT_OUT: Final = """\
# Left out as secrets, or for their control characters: {names}.
# Add them to this file as NAME=value, readable by its owner only.
EnvironmentFile=-{file}
"""
_NETWORK: Final = "Wants=network-online.target\nAfter=network-online.target\n"


class ServiceUnit(Struct, frozen=True, kw_only=True):
    """Values of the unit."""

    config: ReplayConfig
    """Its `source` is absolute."""
    program: Path
    folder: Path
    user: str
    """Empty for a unit of a user's own manager."""
    environment: Mapping[str, str]
    left_out: tuple[str, ...] = ()
    """Names of variables that must not stand in a unit."""
    arguments: tuple[str, ...] = ()
    """Of the configuration, ``name:=value``."""
    log_dir: Path | None = None

    @property
    def name(self) -> str:
        """The name of the unit without ``.service``."""
        kept = (each if each.isascii() and each.isalnum() else "-" for each in self.config.name)
        return "".join(kept).strip("-") or "play-launch"


def unit_text(service: ServiceUnit) -> str:
    config, user = service.config, service.user
    variables = {**service.environment, **config.environment}
    is_local = variables.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper() in {"LOCALHOST", "OFF"}
    environment = "".join(
        f"Environment={quoted(f'{name}={value}')}\n" for name, value in service.environment.items()
    )
    if service.left_out:
        folder = "/etc/play-launch" if user else "%E/play-launch"
        names = ", ".join(ascii(name)[1:-1] for name in service.left_out)
        environment += _LEFT_OUT.format(names=names, file=f"{folder}/{service.name}.env")
    log_dir = () if service.log_dir is None else ("--log-dir", str(service.log_dir))
    reload = _command(service, "apply", "--session", _MAIN_PID)
    name = " ".join(config.name.split()) or "robot"
    return _UNIT.format(
        name=name,
        unit=service.name,
        place="/etc/systemd/system" if user else "~/.config/systemd/user",
        systemctl="systemctl" if user else "systemctl --user",
        description=specified(name),
        network=_NETWORK if user and not is_local else "",
        user=f"User={user}\n" if user else "",
        folder=specified(str(service.folder)),
        start=_command(service, "replay", "--quiet", *log_dir),
        reload=reload.replace(argument(_MAIN_PID), _MAIN_PID),
        environment=environment,
        limits="".join(f"Limit{name}={limit}\n" for name, limit in _limits(config).items()),
        stop=stop_seconds(config),
        target="multi-user.target" if user else "default.target",
    )


def _command(service: ServiceUnit, *words: str) -> str:
    every = (str(service.program), *words, str(service.config.source), *service.arguments)
    return " ".join(map(argument, every))


def _limits(config: ReplayConfig) -> dict[str, str]:
    """Return the limits by the names of systemd.exec(5) that the configuration needs.

    Limits whose default is infinity, and lower ones, which would bind the supervisor, are not set.
    """
    every = [each.resources for each in config.containers]
    every += [node.resources for each in config.containers for node in each.composable_nodes]
    every += [each.resources for each in config.nodes]
    highest: dict[str, float] = {"nofile": _OPEN_FILES, "rtprio": _OWN_PRIORITY, "nice": 0}
    for resources in every:
        wanted = [(limit.name, limit.hard) for limit in resources.rlimits]
        if resources.scheduler is not None:
            wanted.append(("rtprio", resources.scheduler.priority))
        if resources.nice is not None and resources.nice < 0:
            wanted.append(("nice", nice_limit(resources.nice)))
        if resources.lock_memory:
            wanted.append(("memlock", math.inf))
        for name, limit in wanted:
            highest[name] = max(limit, highest.get(name, 0))
    files, priority, nice = (highest[name] for name in ("nofile", "rtprio", "nice"))
    return {
        "NOFILE": f"4096:{'infinity' if math.isinf(files) else int(files)}",
        "RTPRIO": str(int(min(priority, 99))),
        **({"NICE": str(int(min(nice, 40)))} if nice else {}),
        **{name.upper(): "infinity" for name in _RESTRICTED if name in highest},
        **(
            {"CORE": "0:infinity"}
            if "core" in highest or any(each.core_dumps for each in config.containers)
            else {}
        ),
    }


def stop_seconds(config: ReplayConfig) -> int:
    """Return the longest time of an orderly stop: units stop after those that depend on them."""
    each: float = sum(astuple(config.stop)) + StopPolicy().sigkill
    before = DependencyGraph(config.start_rules, config.units).stopped_after()
    left, generations = set(before), 0
    while left:
        now = {unit for unit in left if not before[unit] & left}
        left -= now or left
        generations += 1
    sessions = 1 if config.machine else max(len(config.machines), 1)
    return math.ceil(max(generations, 1) * each + sessions * _CLOSING_TIME)


def carried(
    environ: Mapping[str, str], required: Mapping[str, str | None]
) -> tuple[dict[str, str], tuple[str, ...]]:
    """Select the variables of a sourced ROS and of the configuration (`required`).

    Returns them, and the names of secrets and of those that systemd does not accept.
    """
    values: dict[str, str] = {}
    left_out: list[str] = []
    for name, value in sorted(environ.items()):
        if name not in _VARIABLES and not name.startswith(_PREFIXES) and required.get(name) is None:
            continue
        # CYCLONEDDS_URI may be the configuration itself, which is no secret.
        text = value.replace("<", " ") if name == "CYCLONEDDS_URI" else value
        if is_acceptable(f"{name}{value}") and not is_secret(name, text):
            values[name] = value
        else:
            left_out.append(name)
    return values, tuple(left_out)


def specified(text: str) -> str:
    return text.replace("%", "%%")


def quoted(text: str) -> str:
    """Quote one word of a setting, see "Quoting" in systemd.syntax(7)."""
    if text and _PLAIN.issuperset(text):
        return text
    return '"' + "".join(_ESCAPES.get(each, each) for each in specified(text)) + '"'


def argument(text: str) -> str:
    """Quote one word of a command line, without variables."""
    return quoted(text.replace("$", "$$"))


def is_acceptable(text: str) -> bool:
    """Whether systemd accepts a text: UTF-8 without control characters but tab and newline."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return all(each in "\t\n" or (each >= " " and each != "\x7f") for each in text)
