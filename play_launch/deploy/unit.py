"""The unit of a system, with comments that say why each line is there. Pure."""

from __future__ import annotations

from pathlib import Path  # noqa: TC003 - msgspec evaluates the annotations
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from play_launch.config.model import ReplayConfig  # noqa: TC001 - as above
from play_launch.deploy.environment import Carried  # noqa: TC001 - as above
from play_launch.deploy.needs import Setting, settings, stop_seconds
from play_launch.deploy.quoting import argument, quoted, specified

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

_WATCHDOG: Final = 30
"""Seconds. Three pulses of the supervisor fit in there."""
_START: Final = 120
"""Seconds to the first pulse, each of which extends the time: interpreter, modules, configuration.

From a slow disk, and beside everything else that starts at boot, that takes long: six times what it
took in a machine that is emulated, ten times as slow as others.
"""
_ON_THIS_MACHINE: Final = frozenset({"LOCALHOST", "OFF"})
_MAIN: Final = "$MAINPID"
"""systemd puts the supervisor's pid in its place."""
_RANGE: Final = "ROS_AUTOMATIC_DISCOVERY_RANGE"


class Service(Struct, frozen=True, kw_only=True):
    """What a unit is made from."""

    config: ReplayConfig
    """Its `source` is absolute."""
    program: Path
    """The command ``play-launch``."""
    folder: Path
    """Working directory."""
    user: str
    """Whose processes they are; empty: the unit is one of a user's own manager."""
    environment: Carried
    arguments: tuple[str, ...] = ()
    """Of the configuration, ``name:=value``."""
    log_dir: Path | None = None

    @property
    def name(self) -> str:
        """The name of the unit without ``.service``."""
        kept = (each if each.isascii() and each.isalnum() else "-" for each in self.config.name)
        return "".join(kept).strip("-") or "play-launch"


def unit_text(service: Service) -> str:
    """Write the unit."""
    sections = {
        "Unit": _unit(service),
        "Service": _service(service),
        "Install": _install(service),
    }
    parts = [_comment(_heading(service))]
    parts += [f"[{name}]\n{_lines(found)}" for name, found in sections.items()]
    return "\n".join(parts)


def _heading(service: Service) -> str:
    name = service.name
    if service.user:
        place, manager = "/etc/systemd/system", "systemctl"
    else:
        place, manager = "~/.config/systemd/user", "systemctl --user"
    more = "" if service.user else "\n  loginctl enable-linger    (from boot on, without a login)"
    return (
        f"{service.config.name}, brought up by play-launch. To install it:\n"
        f"  cp {name}.service {place}/ && {manager} daemon-reload\n"
        f"  {manager} enable --now {name}{more}\n"
        "Write it anew with `play-launch systemd-unit` when `resources`, `stop` or `depends_on` of "
        "the\nconfiguration have changed, or the environment that it was made in."
    )


def _unit(service: Service) -> Iterator[Setting]:
    description = " ".join(service.config.name.split()) or "robot"
    yield Setting("", (f"Description={specified(description)} (play-launch)",))
    if service.user and not _stays_here(service):
        yield Setting(
            "DDS uses the network interfaces that are there when a node starts.",
            ("Wants=network-online.target", "After=network-online.target"),
        )
    yield Setting(
        "What fails five times in five minutes is left alone; `systemctl reset-failed` ends that.",
        ("StartLimitIntervalSec=300", "StartLimitBurst=5"),
    )


def _stays_here(service: Service) -> bool:
    everywhere = {**service.environment.values, **service.config.environment}
    return everywhere.get(_RANGE, "").upper() in _ON_THIS_MACHINE


def _service(service: Service) -> Iterator[Setting]:
    yield Setting(
        "Started when everything is loaded and runs, or has failed for good: play-launch says so. "
        "No process\nof the system can say it in its place.",
        ("Type=notify", "NotifyAccess=main"),
    )
    if service.user == "root":
        yield Setting("A user of its own is better: run systemd-unit as that user.", ("User=root",))
    elif service.user:
        yield Setting(
            "At the end of this user's last login, logind removes their shared memory, that of DDS "
            "too:\n`loginctl enable-linger` prevents that (not needed for accounts below 1000).",
            (f"User={service.user}",),
        )
    yield Setting(
        "What nodes print is in the recording and in `play-launch logs`; the journal has what "
        "happens.",
        (
            f"WorkingDirectory={specified(str(service.folder))}",
            f"ExecStart={_command(service, 'replay', '--quiet', *_log_dir(service))}",
        ),
    )
    # The session is the one that this service runs, whatever else the user runs.
    reload = _command(service, "apply", "--session", _MAIN).replace(argument(_MAIN), _MAIN)
    yield Setting(
        "`systemctl reload` changes what differs from the configuration by now, and nothing else.",
        (f"ExecReload={reload}",),
    )
    yield from _environment(service)
    yield from _life(service)
    yield from settings(service.config, for_user=not service.user)


def _life(service: Service) -> Iterator[Setting]:
    yield Setting(
        "From a cold start to the first sign of life. From then on, while the system starts or "
        "reloads,\nplay-launch has the time extended as long as it is well.",
        (f"TimeoutStartSec={_START}",),
    )
    yield Setting(
        "Fed only while the supervisor's event loop turns and all of its members are looked after.",
        (f"WatchdogSec={_WATCHDOG}",),
    )
    yield Setting(
        "SIGTERM goes to play-launch alone, which stops the rest in order. This is the most that "
        "`stop`\nand `depends_on` of the configuration can take; then all that is left is killed.",
        ("KillMode=mixed", f"TimeoutStopSec={stop_seconds(service.config)}"),
    )
    yield Setting(
        "Exit codes: 1 a node failed, 3 nodes were missing, 128+n ended by a signal, which is how "
        "it is\nstopped; 2 a mistake in the configuration, which a restart does not mend.",
        (
            "Restart=on-failure",
            "RestartSec=2",
            "SuccessExitStatus=129 130 143",
            "RestartPreventExitStatus=2",
        ),
    )
    yield Setting(
        "Control groups of nodes (`resources`) are play-launch's to make.", ("Delegate=yes",)
    )
    yield Setting(
        "A process that the kernel kills for its memory is play-launch's to start again.",
        ("OOMPolicy=continue",),
    )


def _environment(service: Service) -> Iterator[Setting]:
    values, secrets, impossible = service.environment
    if values:
        yield Setting(
            "The environment of the shell in which this was made: ROS, its middleware, and what "
            "the\nconfiguration takes by ${env:...}.",
            tuple(f"Environment={quoted(f'{name}={value}')}" for name, value in values.items()),
        )
    if secrets:
        place = "/etc/play-launch" if service.user else "%E/play-launch"
        yield Setting(
            f"They look like secrets, and everybody can read a unit: {', '.join(secrets)}. Put "
            "them into this\nfile as NAME=value, readable by its owner only.",
            (f"EnvironmentFile=-{place}/{service.name}.env",),
        )
    if impossible:
        named = ", ".join(ascii(name)[1:-1] for name in impossible)
        yield Setting(f"Left out, for systemd takes no control characters: {named}.")


def _install(service: Service) -> Iterator[Setting]:
    target = "multi-user.target" if service.user else "default.target"
    yield Setting("", (f"WantedBy={target}",))


def _log_dir(service: Service) -> tuple[str, ...]:
    return () if service.log_dir is None else ("--log-dir", str(service.log_dir))


def _command(service: Service, *words: str) -> str:
    source = str(service.config.source)
    every = (str(service.program), *words, source, *service.arguments)
    return " ".join(map(argument, every))


def _lines(found: Iterable[Setting]) -> str:
    return "".join(
        _comment(each.why) * bool(each.why) + "".join(f"{line}\n" for line in each.lines)
        for each in found
    )


def _comment(text: str) -> str:
    return "".join(f"# {line}\n" for line in text.splitlines())
