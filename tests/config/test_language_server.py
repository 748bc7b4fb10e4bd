"""The samples in an editor: what the language server for YAML says about them.

It is installed from npm's registry; without that, there is nothing to ask.
"""

from __future__ import annotations

import itertools
import json
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT: Final = Path(__file__).resolve().parents[2]
SAMPLES: Final = sorted((ROOT / "configs").glob("*.yaml"))
PACKAGE: Final = "yaml-language-server@1.19.2"
UNREACHABLE: Final = ("ENOTFOUND", "EAI_AGAIN", "ECONNREFUSED", "ETIMEDOUT", "ENETUNREACH")


class LanguageServer:
    """Speaks the language server protocol with a process."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self._process = process
        self._numbers = itertools.count(1)
        self.diagnostics: dict[str, list[dict[str, Any]]] = {}

    def notify(self, method: str, params: Any) -> None:
        self._send({"method": method, "params": params})

    def ask(self, method: str, params: Any) -> Any:
        number = next(self._numbers)
        self._send({"id": number, "method": method, "params": params})
        while (said := self._read()).get("id") != number or "method" in said:
            self._hear(said)
        assert "error" not in said, said
        return said.get("result")

    def diagnostics_of(self, uri: str) -> list[dict[str, Any]]:
        while uri not in self.diagnostics:
            self._hear(self._read())
        return self.diagnostics.pop(uri)

    def _hear(self, said: dict[str, Any]) -> None:
        if said.get("method") == "textDocument/publishDiagnostics":
            self.diagnostics[said["params"]["uri"]] = said["params"]["diagnostics"]
        elif "method" in said and "id" in said:
            # It asks for settings; there are none.
            items = said.get("params", {}).get("items", [None])
            self._send({"id": said["id"], "result": [None] * len(items)})

    def _send(self, message: dict[str, Any]) -> None:
        content = json.dumps({"jsonrpc": "2.0", **message}).encode()
        assert self._process.stdin is not None
        self._process.stdin.write(b"Content-Length: %d\r\n\r\n%b" % (len(content), content))
        self._process.stdin.flush()

    def _read(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        length = 0
        while line := self._process.stdout.readline().strip():
            name, _, value = line.partition(b":")
            length = int(value) if name.lower() == b"content-length" else length
        assert length, "the language server has ended"
        said = json.loads(self._process.stdout.read(length))
        assert isinstance(said, dict)
        return said


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LanguageServer]:
    folder = tmp_path_factory.mktemp("npm")
    command = ["npm", "install", "--no-audit", "--no-fund", "--ignore-scripts", PACKAGE]
    try:
        installed = subprocess.run(
            command, cwd=folder, check=False, capture_output=True, text=True, timeout=180
        )
    except FileNotFoundError:
        pytest.skip("there is no npm, so there is no language server to ask")
    if any(word in installed.stderr for word in UNREACHABLE):
        pytest.skip(f"npm's registry is unreachable: {installed.stderr.splitlines()[-1]}")
    assert installed.returncode == 0, installed.stderr
    program = folder / "node_modules" / ".bin" / "yaml-language-server"
    with subprocess.Popen(
        [program, "--stdio"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=folder
    ) as process:
        made = LanguageServer(process)
        made.ask(
            "initialize",
            {"processId": None, "rootUri": ROOT.as_uri(), "capabilities": {"workspace": {}}},
        )
        made.notify("initialized", {})
        yield made
        process.kill()


def opened(server: LanguageServer, file: Path, text: str) -> str:
    uri = file.as_uri()
    document = {"uri": uri, "languageId": "yaml", "version": 1, "text": text}
    server.notify("textDocument/didOpen", {"textDocument": document})
    return uri


def at(uri: str, text: str, where: str) -> dict[str, Any]:
    """Return the position behind the first `where`."""
    before = text[: text.index(where) + len(where)]
    line = before.count("\n")
    return {
        "textDocument": {"uri": uri},
        "position": {"line": line, "character": len(before.rpartition("\n")[2])},
    }


def labels(completion: Any) -> set[str]:
    items = completion["items"] if isinstance(completion, dict) else completion
    return {item["label"] for item in items}


def test_an_editor_knows_the_samples(server: LanguageServer) -> None:
    for file in SAMPLES:
        uri = opened(server, file, file.read_text(encoding="utf-8"))
        assert server.diagnostics_of(uri) == [], file
        server.notify("textDocument/didClose", {"textDocument": {"uri": uri}})


def test_hover_and_completion(server: LanguageServer) -> None:
    text = (ROOT / "configs" / "demo.yaml").read_text(encoding="utf-8")
    text += "  - name: more\n    container_type: \n    \nrecord:\n  \n"
    file = ROOT / "configs" / "unsaved.yaml"
    uri = opened(server, file, text)
    hover = server.ask("textDocument/hover", at(uri, text, "\n  container_ty"))
    assert "each node a process of its own in shared memory" in json.dumps(hover)
    record = labels(server.ask("textDocument/completion", at(uri, text, "\nrecord:\n  ")))
    assert {"budget", "before_crash", "topics"} <= record
    keys = labels(server.ask("textDocument/completion", at(uri, text, "container_type: \n    ")))
    assert {"composable_nodes", "environment", "thread_num"} <= keys
    assert "command" not in keys
    kinds = labels(
        server.ask("textDocument/completion", at(uri, text, "more\n    container_type: "))
    )
    assert {"standard", "mt", "isolated", "isolated_mt", "stock"} <= kinds


def test_mistakes_are_marked(server: LanguageServer) -> None:
    text = (ROOT / "configs" / "demo.yaml").read_text(encoding="utf-8")
    uri = opened(
        server, ROOT / "configs" / "mistaken.yaml", text.replace("thread_num: 2", "threads: 2")
    )
    (found,) = server.diagnostics_of(uri)
    assert "threads is not allowed" in found["message"]
