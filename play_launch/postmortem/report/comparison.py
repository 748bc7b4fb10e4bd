"""The page of two sessions: the verdict, then their numbers beside each other. It has no script."""

from __future__ import annotations

from html import escape
from itertools import chain
from math import isfinite
from typing import TYPE_CHECKING, Final, NamedTuple, TypeAlias

from play_launch.postmortem.comparison import Change, Measure
from play_launch.postmortem.report.facts import unread
from play_launch.postmortem.report.page import render_without_script
from play_launch.postmortem.report.text import shown

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from play_launch.postmortem.comparison import Comparison, CrashChange
    from play_launch.postmortem.story import Story

MOST: Final = 15
"""Rows of a table that are shown at once."""
_ROW: Final = "<tr>"
_BAD_ROW: Final = '<tr class="bad">'
_NUMBERS: Final = {
    title: f'<th class="number">{title}</th>' for title in ("First", "Second", "Difference")
}


Section: TypeAlias = "tuple[str, Sequence[str]]"
"""A title and its lines."""


class Words(NamedTuple):
    """What the text form says."""

    verdict: str
    reasons: Sequence[Section]
    """What is worse, what is better."""
    others: Sequence[Section]
    """What only one session has, and what else differs."""


class Shape(NamedTuple):
    """How the numbers of a measure are written."""

    title: str
    unit: str
    decimals: int
    empty: str
    """Said where there are none."""
    scale: float = 1.0
    """From the measure's own unit."""


SHAPES: Final = {
    Measure.BRING_UP: Shape(
        *("Time until a node is loaded first", "Seconds after the start", 2),
        "No node was loaded in both sessions.",
    ),
    Measure.RESTARTS: Shape(
        "Restarts and reloads", "How often", 0, "Nothing was restarted in either session."
    ),
    Measure.PEAK_MEMORY: Shape(
        "Peak memory", "MB", 1, "There are no samples of a process in both sessions.", 1e-6
    ),
    Measure.CPU: Shape(
        *("CPU, on average", "Percent of a core", 1),
        "There are no samples of a process in both sessions.",
    ),
}


def scaled(change: Change) -> tuple[float, float]:
    """Give both numbers in the unit in which they are shown."""
    scale = SHAPES[change.measure].scale
    return change.before * scale, change.after * scale


def comparison_page(stories: tuple[Story, Story], found: Comparison, words: Words) -> str:
    """Give the HTML."""
    names = [shown(story.session.about.get("name", "")) for story in stories]
    title = " and ".join(dict.fromkeys(filter(None, names))) or "Sessions of an unknown name"
    return render_without_script("comparison.html", title, "\n".join(_body(stories, found, words)))


def _body(stories: tuple[Story, Story], found: Comparison, words: Words) -> Iterator[str]:
    for which, story in zip(("first", "second"), stories, strict=True):
        for notice in unread(story.session.reader):
            yield f'<p class="notice">Of the {which} session: {_text(notice)}</p>'
    bad = " bad" if found.is_worse else ""
    yield _card(f'<p class="verdict{bad}">{_text(words.verdict)}</p>{_lists(words.reasons)}')
    yield _card(_measure(Measure.BRING_UP, found))
    yield _card(_measure(Measure.RESTARTS, found))
    yield _card(f"<h2>Crashes whose number differs</h2>{_crashes(found)}")
    yield _card(_measure(Measure.PEAK_MEMORY, found))
    yield _card(_measure(Measure.CPU, found))
    if others := _lists(words.others):
        yield _card(others)
    yield _card(f"<h2>Sessions</h2>{_sessions(stories)}")


def _measure(measure: Measure, found: Comparison) -> str:
    shape = SHAPES[measure]
    changes = [each for each in found.changes if each.measure is measure]
    if measure is Measure.RESTARTS:
        changes = [each for each in changes if each.before or each.after]
    changes.sort(key=lambda each: (-abs(each.after - each.before), each.who))
    # A damaged sample may hold any number, or none.
    most = max(filter(isfinite, chain.from_iterable(map(scaled, changes))), default=0.0)
    rows = [_row(each, shape, most) for each in changes]
    parts = [f"<h2>{shape.title}</h2>"]
    if not rows:
        parts.append(f'<p class="muted">{shape.empty}</p>')
        return "".join(parts)
    order = "the largest difference first, the upper bar is the first session"
    parts.append(f'<p class="muted">{shape.unit}; {order}.</p>')
    heads = ("Name", "First", "Second", "Difference", "", "")
    parts.append(_table(heads, rows[:MOST]))
    if rows[MOST:]:
        more = f"<summary>{len(rows) - MOST} that differ no more than these</summary>"
        parts.append(f"<details>{more}{_table(heads, rows[MOST:])}</details>")
    return "".join(parts)


def _row(change: Change, shape: Shape, most: float) -> str:
    before, after = scaled(change)
    judged = "worse" if change.is_worse else "better" if change.is_better else ""
    form = f".{shape.decimals}f"
    difference = f"{after - before:+{form}}"
    if not difference.strip("+-0."):
        difference = f"{0:{form}}"
    numbers = (f"{before:{form}}", f"{after:{form}}", difference)
    cells = "".join(f'<td class="number">{number}</td>' for number in numbers)
    bars = _bar(before, most, 0) + _bar(after, most, 7)
    return (
        f"{_BAD_ROW if change.is_worse else _ROW}<td>{_name(change.who)}</td>{cells}"
        f'<td>{judged}</td><td class="bar-cell">'
        f'<svg class="pair" aria-hidden="true">{bars}</svg></td></tr>'
    )


def _bar(value: float, most: float, y: int) -> str:
    share = value / most if 0 < value <= most else 0.0
    return f'<rect y="{y}" width="{share:.2%}" height="6"/>'


def _crashes(found: Comparison) -> str:
    rows = [
        f'{begin}<td><code>{each.signature.id}</code></td><td class="number">{each.before}</td>'
        f'<td class="number">{each.after}</td><td>{_frames(each)}</td>'
        f"<td>{', '.join(map(_name, each.who))}</td></tr>"
        for begin, changes in (
            (_BAD_ROW, (*found.new_crashes, *found.more_crashes)),
            (_ROW, (*found.gone_crashes, *found.fewer_crashes)),
        )
        for each in changes
    ]
    if not rows:
        return '<p class="muted">There are none.</p>'
    return _table(("Signature", "First", "Second", "Crash", "Of"), rows)


def _frames(crash: CrashChange) -> str:
    signature = crash.signature
    return "<br>".join(_name(line) for line in (str(signature), *signature.frames[1:]))


def _sessions(stories: tuple[Story, Story]) -> str:
    sessions = [story.session for story in stories]
    rows = {
        "File": [str(each.reader.path) for each in sessions],
        "Session": [each.about.get("name", "unknown") for each in sessions],
        "Number": [each.about.get("id", "unknown") for each in sessions],
        "Version of play-launch": [
            each.about.get("play_launch_version") or "unknown" for each in sessions
        ],
        "Duration": [
            f"{max(0, each.reader.end - each.reader.begin) / 1e9:.1f} s" for each in sessions
        ],
    }
    return _table(
        ("", "The first", "The second"),
        (
            f"<tr><td>{title}</td>{''.join(f'<td>{_name(value)}</td>' for value in values)}</tr>"
            for title, values in rows.items()
        ),
    )


def _table(heads: Iterable[str], rows: Iterable[str]) -> str:
    titles = "".join(_NUMBERS.get(head, f"<th>{head}</th>") for head in heads)
    head = f"<thead><tr>{titles}</tr></thead>"
    return f'<table class="wide">{head}<tbody>{"".join(rows)}</tbody></table>'


def _lists(sections: Iterable[Section]) -> str:
    return "".join(
        f"<h2>{_text(title)}</h2><ul>{''.join(f'<li>{_text(line)}</li>' for line in lines)}</ul>"
        for title, lines in sections
        if lines
    )


def _card(content: str) -> str:
    return f'<section class="card">{content}</section>'


def _name(text: str) -> str:
    """Of foreign text whose direction may be another one."""
    return f"<bdi>{_text(text)}</bdi>"


def _text(text: str) -> str:
    return escape(shown(text))
