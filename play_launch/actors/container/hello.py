"""What a container's hello says about it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from play_launch.config.model import Isolation

if TYPE_CHECKING:
    from play_launch.config.model import ContainerConfig
    from play_launch.wire.messages import Hello


def description(hello: Hello) -> str:
    """Say in one line what kind of container it is, and what that rests on."""
    mode = f"{hello.mode} by {hello.mechanism}" if hello.mechanism else hello.mode
    facts = f"{mode}, {hello.rmw_implementation}, domain {hello.domain_id}"
    return "; ".join([facts, *hello.notes])


def isolation_shortfall(config: ContainerConfig, hello: Hello) -> str:
    """Say how its nodes are isolated otherwise than they would be at best; empty if they are not.

    The text is the same for all containers with the same reasons.
    """
    wanted = config.isolation
    at_best = Isolation.SHARED_MEMORY if wanted is Isolation.AUTO else wanted
    if not hello.mechanism or hello.mechanism == at_best:
        return ""
    reasons = "; ".join(hello.notes) or "it does not say why"
    return f"nodes are isolated by {hello.mechanism}, not by {at_best}: {reasons}"
