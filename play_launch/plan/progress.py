"""What a system is after some steps of a plan, so also after one that failed halfway."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

from msgspec.structs import replace

from play_launch.plan.steps import Action, Kind

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from play_launch.config.model import ContainerConfig, ReplayConfig
    from play_launch.plan.steps import Step

_One = TypeVar("_One")
_Name = TypeVar("_Name")


def after(running: ReplayConfig, target: ReplayConfig, done: Iterable[Step]) -> ReplayConfig:
    """Give the configuration after ``done``, some steps of the plan from one to the other."""
    actions = {step.id: step.action for step in done if step.action is not Action.KEEP}
    is_adopted = (Kind.SESSION, "") in actions
    return replace(
        running,
        stop=target.stop if is_adopted else running.stop,
        start_rules=target.start_rules if is_adopted else running.start_rules,
        managed=target.managed if is_adopted else running.managed,
        containers=_merged(
            {each.full_name: each for each in running.containers},
            {each.full_name: each for each in target.containers},
            lambda name, old, new: _container(actions, name, old, new),
        ),
        nodes=_merged(
            {each.full_name: each for each in running.nodes},
            {each.full_name: each for each in target.nodes},
            lambda name, old, new: _chosen(actions.get((Kind.PROCESS, name)), old, new),
        ),
    )


def _container(
    actions: Mapping[tuple[Kind, str], Action],
    name: str,
    old: ContainerConfig | None,
    new: ContainerConfig | None,
) -> ContainerConfig | None:
    action = actions.get((Kind.CONTAINER, name))
    chosen = _chosen(action, old, new)
    if chosen is None or old is None or new is None or action not in {None, Action.ADOPT}:
        return chosen
    nodes = _merged(
        {node.key: node for node in old.composable_nodes},
        {node.key: node for node in new.composable_nodes},
        lambda key, was, is_: _chosen(actions.get((Kind.COMPONENT, str(key))), was, is_),
    )
    return replace(chosen, composable_nodes=nodes)


def _chosen(action: Action | None, old: _One | None, new: _One | None) -> _One | None:
    """Give the one that holds; without a step that is what was there, even if that is nothing."""
    return old if action is None else new


def _merged(
    old: Mapping[_Name, _One],
    new: Mapping[_Name, _One],
    choose: Callable[[_Name, _One | None, _One | None], _One | None],
) -> tuple[_One, ...]:
    """Choose for each name; in the order of the new ones, and then those that are only old."""
    chosen = (choose(name, old.get(name), new.get(name)) for name in dict.fromkeys((*new, *old)))
    return tuple(one for one in chosen if one is not None)
