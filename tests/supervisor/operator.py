"""A system that does what the steps of a plan say, and nothing else.

It knows values by their paths only, so a step that leaves out a change leaves the old value.
"""

from __future__ import annotations

from collections import Counter
from copy import deepcopy
from typing import Any

from play_launch.config.description import describe
from play_launch.config.model import ReplayConfig
from play_launch.supervisor.plan import ItemChange, Plan, PlanAction, PlanKind, Step


class Operated:
    """What runs, by kind and name; each start and each load is a further life."""

    def __init__(self, config: ReplayConfig, absent: set[str]) -> None:
        self.things = things(config)
        self.absent = set(absent)
        self.lives = Counter(dict.fromkeys(self.things, 1))
        self.touched: set[tuple[PlanKind, str]] = set()

    def carry_out(self, plan: Plan, target: ReplayConfig) -> None:
        wanted = things(target)
        for phase in plan.phases():
            for step in phase:
                self._do(step, wanted)

    def _do(self, step: Step, wanted: dict[tuple[PlanKind, str], Any]) -> None:
        self.touched.add(step.id)
        match step.action:
            case PlanAction.REMOVE:
                for each in self._with_nodes(step):
                    del self.things[each]
            case PlanAction.ADOPT | PlanAction.SET:
                assert step.name not in self.absent, "nothing runs that could take it"
                for change in step.changes:
                    self._change(step, change)
            case PlanAction.ADD:
                assert not self._with_nodes(step), "it is there already"
                self._begin(step, wanted)
            case PlanAction.RELOAD | PlanAction.RESTART | PlanAction.LOAD | PlanAction.START:
                for each in self._with_nodes(step):
                    del self.things[each]
                self._begin(step, wanted)
            case PlanAction.KEEP:
                raise AssertionError("nothing is to be done")

    def _begin(self, step: Step, wanted: dict[tuple[PlanKind, str], Any]) -> None:
        for (kind, name), described in wanted.items():
            if (kind, name) == step.id or _is_inside(kind, name, step):
                self.things[kind, name] = deepcopy(described)
                self.lives[kind, name] += 1
                self.absent.discard(name)
                self.touched.add((kind, name))

    def _with_nodes(self, step: Step) -> list[tuple[PlanKind, str]]:
        return [each for each in self.things if each == step.id or _is_inside(*each, step)]

    def _change(self, step: Step, change: ItemChange) -> None:
        first, _, rest = change.path.partition(".")
        place = self.things[step.id]
        if rest:
            if change.after is None:
                del place[first][rest]
            else:
                place[first][rest] = change.after
        else:
            place[first] = change.after


def _is_inside(kind: PlanKind, name: str, step: Step) -> bool:
    is_node = kind is PlanKind.COMPONENT and step.kind is PlanKind.CONTAINER
    return is_node and name.startswith(f"{step.name}:")


def things(config: ReplayConfig) -> dict[tuple[PlanKind, str], Any]:
    """Everything that a configuration declares; lines are no part of it."""
    found: dict[tuple[PlanKind, str], Any] = {}
    described: Any = describe(config)
    for container in described["containers"]:
        for node in container.pop("composable_nodes"):
            found[PlanKind.COMPONENT, node["key"]] = node
        found[PlanKind.CONTAINER, container["full_name"]] = container
    for process in described["nodes"]:
        found[PlanKind.PROCESS, process["full_name"]] = process
    for thing in found.values():
        del thing["line"], thing["file"]
    found[PlanKind.SESSION, ""] = {"stop": described["stop"]}
    return found
