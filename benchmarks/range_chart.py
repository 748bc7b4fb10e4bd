"""A picture of ranges on a logarithmic scale, as SVG; readable in light and dark pages."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

_OPEN = '<svg xmlns="http://www.w3.org/2000/svg"'
_COLOURS = ("#2f6fde", "#d9822b", "#3d9a50", "#a24bc4")
_LABEL, _PLOT, _RIGHT = 250, 560, 50
_LANE, _BETWEEN, _TOP, _BOTTOM = 9, 9, 74, 34
_STYLE = (
    "text{font:12px sans-serif;fill:#808890}"
    ".title{font-size:15px;font-weight:bold}"
    ".grid{stroke:#808890;stroke-opacity:.3}"
    ".range{stroke-width:5;stroke-linecap:round}"
)


@dataclass(frozen=True, slots=True)
class Lane:
    """A range of one quantity; None where nothing was measured."""

    name: str
    ends: tuple[float, float] | None


@dataclass(frozen=True, slots=True)
class Bar:
    """What one label has to show; lanes at the same place in all bars have the same colour."""

    label: str
    lanes: Sequence[Lane]


def decades(values: Sequence[float]) -> range:
    """The exponents of ten from below the smallest to above the largest, at least one decade."""
    low = math.floor(math.log10(min(values)))
    return range(low, max(math.ceil(math.log10(max(values))), low + 1) + 1)


def range_chart(title: str, unit: str, bars: Sequence[Bar]) -> str:
    """Draw it.

    Raises:
        ValueError: When there is nothing to draw.
    """
    smallest = 1e-6
    values = [
        max(end, smallest) for bar in bars for lane in bar.lanes if lane.ends for end in lane.ends
    ]
    if not values:
        raise ValueError("nothing was measured that could be drawn")
    ticks = decades(values)

    def x(value: float) -> float:
        part = (math.log10(max(value, smallest)) - ticks[0]) / (ticks[-1] - ticks[0])
        return _LABEL + part * _PLOT

    names = [lane.name for lane in bars[0].lanes]
    heights = [_LANE * len(bar.lanes) + _BETWEEN for bar in bars]
    bottom = _TOP + sum(heights)
    width, height = _LABEL + _PLOT + _RIGHT, bottom + _BOTTOM
    drawn = [
        f'{_OPEN} viewBox="0 0 {width} {height}" width="{width}" height="{height}">',
        f"<style>{_STYLE}</style>",
        f'<text class="title" x="10" y="22">{escape(title)}</text>',
    ]
    place = 10.0
    for name, colour in zip(names, _COLOURS, strict=False):
        drawn.append(_range(place, place + 14, 42, colour, name))
        drawn.append(f'<text x="{place + 22}" y="46">{escape(name)}</text>')
        place += 40 + 6.2 * len(name)
    for exponent in ticks:
        at = x(10.0**exponent)
        drawn.append(f'<line class="grid" x1="{at:.1f}" x2="{at:.1f}" y1="{_TOP}" y2="{bottom}"/>')
        drawn.append(
            f'<text text-anchor="middle" x="{at:.1f}" y="{bottom + 18}">'
            f"{10.0**exponent:g} {escape(unit)}</text>"
        )
    top = float(_TOP)
    for bar, space in zip(bars, heights, strict=True):
        middle = top + (space - _BETWEEN) / 2
        drawn.append(
            f'<text text-anchor="end" x="{_LABEL - 12}" y="{middle + 6}">{escape(bar.label)}</text>'
        )
        for i, (lane, colour) in enumerate(zip(bar.lanes, _COLOURS, strict=False)):
            if lane.ends is not None:
                low, high = lane.ends
                text = f"{lane.name}: {low:g} to {high:g} {unit}"
                drawn.append(_range(x(low), x(high), top + 5 + i * _LANE, colour, text))
        top += space
    return "\n".join([*drawn, "</svg>"]) + "\n"


def _range(low: float, high: float, y: float, colour: str, text: str) -> str:
    return (
        f'<line class="range" stroke="{colour}" x1="{low:.1f}" x2="{high:.1f}" '
        f'y1="{y:.1f}" y2="{y:.1f}"><title>{escape(text)}</title></line>'
    )
