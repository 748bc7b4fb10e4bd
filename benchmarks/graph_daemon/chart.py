"""A picture of two daemons on a logarithmic scale, as SVG."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape

_OPEN = '<svg xmlns="http://www.w3.org/2000/svg"'
_COLOURS = ("#2f6fde", "#d9822b")
_LABEL, _PLOT, _VALUE = 270, 470, 90
_LANE, _BETWEEN, _TOP, _BOTTOM = 12, 14, 66, 30
_STYLE = (
    "text{font:12px sans-serif;fill:#808890}.title{font-size:15px;font-weight:bold}"
    ".grid{stroke:#808890;stroke-opacity:.3}"
)


def chart(title: str, rows: Sequence[str], subjects: Mapping[str, Mapping[str, float]]) -> str:
    """Draw a bar for each subject in each row, in milliseconds; what never came ends in an arrow.

    Rows that no subject has are left out.
    """
    shown = [row for row in rows if any(row in figures for figures in subjects.values())]
    values = [
        figures[row] * 1e3
        for figures in subjects.values()
        for row in shown
        if row in figures and 0 < figures[row] < math.inf
    ]
    low = math.floor(math.log10(min(values)))
    high = max(math.ceil(math.log10(max(values))), low + 1)

    def x(milliseconds: float) -> float:
        part = (math.log10(max(milliseconds, 10.0**low)) - low) / (high - low)
        return _LABEL + min(1.0, part) * _PLOT

    height_of_row = _LANE * len(subjects) + _BETWEEN
    bottom = _TOP + height_of_row * len(shown)
    width, height = _LABEL + _PLOT + _VALUE, bottom + _BOTTOM
    drawn = [
        f'{_OPEN} viewBox="0 0 {width} {height}" width="{width}" height="{height}">',
        f"<style>{_STYLE}</style>",
        f'<text class="title" x="10" y="22">{escape(title)}</text>',
    ]
    for place, (name, colour) in enumerate(zip(subjects, _COLOURS, strict=False)):
        left = 10 + 130 * place
        drawn.append(f'<rect x="{left}" y="36" width="14" height="10" fill="{colour}"/>')
        drawn.append(f'<text x="{left + 20}" y="46">{escape(name)}</text>')
    for exponent in range(low, high + 1):
        at = x(10.0**exponent)
        label = f"{10.0**exponent:g} ms" if exponent < 3 else f"{10.0 ** (exponent - 3):g} s"
        drawn.append(f'<line class="grid" x1="{at:.1f}" x2="{at:.1f}" y1="{_TOP}" y2="{bottom}"/>')
        drawn.append(f'<text text-anchor="middle" x="{at:.1f}" y="{bottom + 18}">{label}</text>')
    for number, row in enumerate(shown):
        top = _TOP + number * height_of_row + _BETWEEN / 2
        middle = top + _LANE * len(subjects) / 2 + 4
        drawn.append(f'<text text-anchor="end" x="{_LABEL - 10}" y="{middle}">{escape(row)}</text>')
        for lane, (figures, colour) in enumerate(zip(subjects.values(), _COLOURS, strict=False)):
            if row not in figures:
                continue
            value = figures[row] * 1e3
            end = x(value)
            at = top + lane * _LANE
            drawn.append(
                f'<rect x="{_LABEL}" y="{at}" width="{max(1.0, end - _LABEL):.1f}" '
                f'height="{_LANE - 2}" fill="{colour}"/>'
            )
            text = "never" if math.isinf(value) else _amount(value)
            drawn.append(f'<text x="{end + 6:.1f}" y="{at + 9}">{text}</text>')
    return "\n".join([*drawn, "</svg>\n"])


def _amount(milliseconds: float) -> str:
    if milliseconds >= 1000:
        return f"{milliseconds / 1000:.3g} s"
    return f"{milliseconds:.3g} ms"
