"""No launch files in XML and YAML."""

from __future__ import annotations

from typing import Any


class Parser:
    frontend_parsers: dict[str, Any] = {}  # noqa: RUF012

    @classmethod
    def load_parser_implementations(cls) -> None:
        pass

    @classmethod
    def load(cls, file: Any) -> Any:
        raise NotImplementedError

    def parse_action(self, entity: Any) -> Any:
        raise NotImplementedError
