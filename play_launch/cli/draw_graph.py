"""What ``play-launch check --graph`` prints: what waits for what."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from play_launch.config.dependency import OnTimeout, StartRule

if TYPE_CHECKING:
    from collections.abc import Iterator

    from play_launch.config.dependency import Dependency
    from play_launch.config.model import ReplayConfig


def as_text(config: ReplayConfig) -> str:
    """Give each unit a line, in the order of the file, and what it waits for below it."""
    lines = []
    for unit in _units(config):
        indentation = "  " if unit.container else ""
        waits = [f"waits for {each}{_limit(each)}" for each in unit.rule.dependencies]
        if unit.rule.delay:
            waits.append(f"waits {unit.rule.delay:g} s")
        lines.append(f"{indentation}{unit.label}")
        lines += [f"{indentation}    {wait}" for wait in waits]
    return "\n".join(lines)


def as_mermaid(config: ReplayConfig) -> str:
    """Write a flow chart: an arrow leads from what is waited for to who waits."""
    names: dict[str, str] = {}
    lines = ["flowchart LR"]
    edges = []
    is_open = False
    for unit in _units(config):
        if is_open and not unit.container:
            lines.append("  end")
            is_open = False
        names[unit.name] = f"u{len(names)}"
        if unit.has_nodes:
            # The container is a unit of its own, inside of what stands for all of its nodes.
            lines.append(f"  subgraph {names[unit.name]}s[{_quoted(unit.label)}]")
            is_open = True
        lines.append(f"  {'  ' if is_open else ''}{names[unit.name]}[{_quoted(unit.label)}]")
        edges += [(each, unit.name) for each in unit.rule.dependencies]
    if is_open:
        lines.append("  end")
    for dependency, name in edges:
        source = dependency.unit or str(dependency)
        if source not in names:
            names[source] = f"w{len(names)}"
            lines.append(f"  {names[source]}([{_quoted(source)}])")
        label = f"{dependency.condition}: {dependency.subject}" if dependency.unit else ""
        label = label.removesuffix(": ")
        arrow = "-.->" if dependency.on_timeout is OnTimeout.START else "-->"
        words = f"|{_quoted(label)}|" if label else ""
        lines.append(f"  {names[source]} {arrow}{words} {names[name]}")
    return "\n".join(lines)


def as_values(config: ReplayConfig) -> dict[str, object]:
    """Give the units and what they wait for; ``timeout`` is seconds, null for any time."""
    units = list(_units(config))
    return {
        "units": [
            {"unit": each.name, "container": each.container or None, "delay": each.rule.delay}
            for each in units
        ],
        "dependencies": [
            {
                "of": each.name,
                "condition": str(dependency.condition),
                "on": dependency.unit or None,
                "subject": dependency.subject or None,
                "timeout": dependency.timeout if math.isfinite(dependency.timeout) else None,
                "on_timeout": str(dependency.on_timeout),
            }
            for each in units
            for dependency in each.rule.dependencies
        ],
    }


class _Unit(NamedTuple):
    name: str
    label: str
    container: str
    rule: StartRule
    has_nodes: bool = False


def _units(config: ReplayConfig) -> Iterator[_Unit]:
    for member, nodes in config.units.items():
        rule = config.start_rules.get(member, StartRule())
        yield _Unit(member, member, "", rule, has_nodes=bool(nodes))
        for node in nodes:
            label = node.removeprefix(f"{member}:")
            yield _Unit(node, label, member, config.start_rules.get(node, StartRule()))


def _limit(dependency: Dependency) -> str:
    limit = f", at most {dependency.timeout:g} s" if math.isfinite(dependency.timeout) else ""
    starts = dependency.on_timeout is OnTimeout.START
    return f"{limit}, else it starts all the same" if starts else limit


def _quoted(text: str) -> str:
    # Mermaid knows entities, and takes what stands in quotes as text.
    entities = {"#": "#35;", '"': "#quot;", "<": "#lt;", ">": "#gt;", "`": "#96;"}
    return '"' + "".join(entities.get(each, each) for each in text) + '"'
