"""Put measured figures into docs/benchmarks.md, and their pictures beside it.

    python -m benchmarks.publish [--note TEXT] crash.json intra_process.json graph_daemon.json

Each file is what a benchmark's --json has written. On the page, what stands between
`<!-- crash -->` and `<!-- /crash -->` is replaced. The note stands above the figures, and has what
else there is to know about the run.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks import intra_process
from benchmarks.crash import report
from benchmarks.crash.goals import goals
from benchmarks.goal import markdown
from benchmarks.graph_daemon import report as graph_daemon
from benchmarks.statistics import Summary

PAGE = Path(__file__).parents[1] / "docs" / "benchmarks.md"
Document = Mapping[str, Any]


class PageError(ValueError):
    """The page has no place for the figures."""


def put(page: str, name: str, content: str) -> str:
    """Replace what stands between the marks of that name."""
    begin, end = f"<!-- {name} -->\n", f"<!-- /{name} -->"
    before, found, rest = page.partition(begin)
    old, closed, after = rest.partition(end)
    if not found or not closed:
        raise PageError(f"the page has no {begin.strip()} … {end}")
    del old
    return f"{before}{begin}{content.strip()}\n{end}{after}"


def crash(document: Document) -> tuple[str, str]:
    """What to write on the page, and the picture."""
    rows = document["rows"]
    counts = " or ".join(f"{count:,}" for count in sorted({row["wanted"] for row in rows}))
    text = (
        f"{_machine(document)}, {counts} crashes per row.\n\n"
        f"{markdown(goals(rows))}\n\n```\n{report.table(rows)}\n```\n\n"
        "![Times of crashes](crash.svg)"
    )
    return text, report.picture(rows)


def two_nodes(document: Document) -> tuple[str, str]:
    rows = {name: Summary.from_json(row) for name, row in document["rows"].items()}
    text = (
        f"{_machine(document)}, {document['rounds']} turns of {document['images']} images of each, "
        f"{document['rate']:g} Hz.\n\n"
        f"{markdown(intra_process.goals(rows))}\n\n```\n{intra_process.table(rows)}\n```\n\n"
        "![Times of 2 MB messages](intra_process.svg)"
    )
    return text, intra_process.picture(rows)


def two_daemons(document: Document) -> tuple[str, str]:
    told, title = document["machine"], document["title"]
    subjects = graph_daemon.from_json(document["subjects"])
    text = (
        f"{title}, {told['architecture']}, Linux {told['kernel']}; {document['storms']} storms.\n\n"
        f"{markdown(graph_daemon.goals(subjects))}\n\n"
        f"```\n{graph_daemon.table(subjects)}\n```\n\n"
        "![Times of both daemons](graph_daemon.svg)"
    )
    return text, graph_daemon.picture(title, subjects)


_KNOWN: Mapping[str, Callable[[Document], tuple[str, str]]] = {
    "crash": crash,
    "intra_process": two_nodes,
    "graph_daemon": two_daemons,
}


def publish(files: Sequence[Path], page: Path, note: str = "") -> None:
    """Change the page, and write the pictures into its folder."""
    text = page.read_text(encoding="utf-8")
    pictures: dict[str, str] = {}
    for file in files:
        document = json.loads(file.read_text(encoding="utf-8"))
        name = document["benchmark"]
        content, pictures[name] = _KNOWN[name](document)
        text = put(text, name, f"{note}\n\n{content}" if note else content)
    page.write_text(text, encoding="utf-8")
    for name, picture in pictures.items():
        (page.parent / f"{name}.svg").write_text(picture, encoding="utf-8")


def _machine(document: Document) -> str:
    told = document["machine"]
    return (
        f"{told['cpus']} CPUs, {told['architecture']}, Linux {told['kernel']}, isolated containers "
        f"with {told['allocator']}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="benchmarks.publish",
        description=__doc__,
        formatter_class=argparse.RawTextHelpFormatter,
    )
    parser.add_argument("files", type=Path, nargs="+")
    parser.add_argument("--page", type=Path, default=PAGE)
    parser.add_argument("--note", default="")
    arguments = parser.parse_args()
    publish(arguments.files, arguments.page, arguments.note)


if __name__ == "__main__":
    main()
