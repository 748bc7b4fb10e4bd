"""What holds for the nodes of a container: default < loading < container < node."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct, field
from msgspec.structs import replace

from play_launch.config.model import ContainerType, Isolation, MemoryDomains
from play_launch.config.policies import OnCrash, RestartLimits
from play_launch.config.resources import Resources

if TYPE_CHECKING:
    from collections.abc import Iterable

    from play_launch.config.schema import (
        ComposableNodeSection,
        ContainerSection,
        LoadingSection,
        RestartSection,
    )
    from play_launch.config.section import Section
    from play_launch.config.yaml.tree import At

ISOLATED_KEYS: Final = (
    "isolation",
    "memory_domains",
    "core_dumps",
    "auto_reload_on_crash",
    "on_crash",
)
"""Keys of containers that say something for isolated ones only."""


class Policy(Struct, frozen=True):
    """What may be said for all containers, for one, and partly for one node; in seconds."""

    container_type: ContainerType = ContainerType.STANDARD
    thread_num: int | None = None
    isolation: Isolation = Isolation.AUTO
    memory_domains: MemoryDomains = MemoryDomains.OFF
    core_dumps: bool = False
    loading_timeout: float = 10.0
    probe_timeout: float = 60.0
    on_crash: OnCrash = OnCrash.RELOAD
    restart: RestartLimits = field(default_factory=RestartLimits)
    resources: Resources = Resources()
    """Of nodes that are processes of their own; not refined here."""

    def refined(
        self, section: LoadingSection | ContainerSection | ComposableNodeSection, at: At
    ) -> Policy:
        """Return this policy with what `section` says instead, which stands at `at`."""
        return replace(
            self,
            **_given(section, _PLAIN),
            on_crash=_refined_on_crash(self.on_crash, section, at),
            restart=refined_restart(self.restart, section.restart, at),
        )


_PLAIN: Final = set(Policy.__struct_fields__) - {"on_crash", "restart", "resources"}


def refined_restart(base: RestartLimits, section: RestartSection | None, at: At) -> RestartLimits:
    """Return `base` with what `section` says instead, which is the key `restart` at `at`."""
    if section is None:
        return base
    given = _given(section, {"max_restarts", "within"})
    pauses = {} if section.backoff is None else section.backoff.given
    limits = replace(base, **given, **pauses)
    if limits.initial > limits.maximum:
        where = at.blame("restart")
        message = f"initial ({limits.initial:g} s) is longer than maximum ({limits.maximum:g} s)"
        where.below("backoff").problem(message)
    return limits


def refuse_unread(keys: Iterable[str], kind: ContainerType, at: At) -> None:
    """Report those of `keys` that stand there, if the container is none that reads them."""
    if not kind.is_isolated:
        why = f"is for container_type isolated and isolated_mt, this container is {kind}"
        refuse(keys, why, at)


def refuse(keys: Iterable[str], why: str, at: At) -> None:
    """Report those of `keys` that stand there."""
    for key in keys:
        value = at.value(key)
        if value is not None:
            value.problem(f"{key} {why}")


def _refined_on_crash(
    base: OnCrash, section: LoadingSection | ContainerSection | ComposableNodeSection, at: At
) -> OnCrash:
    automatic, on_crash = section.auto_reload_on_crash, section.on_crash
    if on_crash is None:
        if automatic is None:
            return base
        return OnCrash.RELOAD if automatic else OnCrash.IGNORE
    if automatic is not None and automatic is not (on_crash is OnCrash.RELOAD):
        message = f"contradicts on_crash: {on_crash}; leave one of them out"
        at.blame("auto_reload_on_crash").problem(message)
    return on_crash


def _given(section: Section, names: set[str]) -> dict[str, Any]:
    return {name: value for name, value in section.given.items() if name in names}
