"""What ``play-launch web`` does: serves the page of a session."""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import os
import socket
import ssl
import time
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from play_launch.cli import options
from play_launch.cli.output import fail, printable, say_live
from play_launch.container.ros import spawn_guard
from play_launch.process.companion import run_companion
from play_launch.supervisor.events import OutputLine, Stream

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from play_launch.cli.web.admission import Rules, Tokens
    from play_launch.config.model import WebConfig
    from play_launch.process.lines import Line

_log = logging.getLogger(__name__)
_LONGEST_MESSAGE: Final = 1_000_000
"""Bytes that a browser may send at once."""
_OPENING: Final = 20
"""Pages that were asked for and have no WebSocket yet: each takes 0.2 MB."""
_OPENS_WITHIN: Final = 10.0
"""Seconds that such a page stays when there are as many."""
_CLOSING: Final = 2
"""Seconds for open requests at the end."""
_AGAIN: Final = "2"
"""Seconds until the report of a system that comes up is loaded again."""


def web(  # noqa: PLR0917 - options, by name
    session: options.Session = None,
    bind: Annotated[
        str, typer.Option("--bind", metavar="ADDRESS", help="Address to listen on.")
    ] = "127.0.0.1",
    port: Annotated[
        int, typer.Option("--port", min=0, max=65535, metavar="PORT", help="0: any that is free.")
    ] = 8080,
    allow_control: Annotated[
        bool,
        typer.Option(
            "--allow-control", help="Visitors may stop, restart and reload. By default they look."
        ),
    ] = False,
    token_file: Annotated[
        Path | None,
        typer.Option(
            "--token-file",
            metavar="FILE",
            help="Demand tokens, and keep them there, readable by the user only. They are demanded "
            "always with --allow-control, and for other addresses than 127.0.0.1; without a file "
            "they are new each time.",
            show_default=False,
        ),
    ] = None,
    allow_host: Annotated[
        list[str] | None,
        typer.Option(
            "--allow-host",
            metavar="NAME",
            help="Another name under which browsers may call this server; may be repeated.",
            show_default=False,
        ),
    ] = None,
    certificate: Annotated[
        Path | None,
        typer.Option("--certificate", metavar="FILE", help="For TLS.", show_default=False),
    ] = None,
    key: Annotated[
        Path | None,
        typer.Option("--key", metavar="FILE", help="Of the certificate.", show_default=False),
    ] = None,
    root_path: Annotated[
        str,
        typer.Option(
            "--root-path", metavar="PATH", help="Where a proxy shows it.", show_default=False
        ),
    ] = "",
    clients: Annotated[
        int, typer.Option("--clients", min=1, max=1000, metavar="N", help="Most open pages.")
    ] = 20,
) -> int:
    """Show a session in a browser: units, their story, the log; with --allow-control, act.

    The page follows the session, and the next one of the same name. Leaving it changes nothing.
    It listens on this machine only. For a tablet: --bind 0.0.0.0, which demands the tokens that
    are printed, one for looking and one for acting.
    """
    if (certificate is None) != (key is None):
        fail("--certificate and --key belong together")
    address = _address(bind)
    # The control socket is for its user only, and 127.0.0.1 for all users of the machine.
    demands = token_file is not None or allow_control or not address.is_loopback
    tokens, is_new = _tokens(token_file) if demands else (None, False)
    from play_launch.cli.web.admission import Rules  # noqa: PLC0415

    rules = Rules(
        hosts=_own_names(allow_host or ()),
        tokens=tokens,
        allows_acting=allow_control,
        clients=clients,
        is_secure=certificate is not None,
    )
    require_nicegui()
    with _listen(address, port) as listener:
        scheme = "https" if certificate else "http"
        shown = socket.gethostname() if address.is_unspecified else bind
        shown = f"[{shown}]" if ":" in shown else shown
        url = f"{scheme}://{shown}:{listener.getsockname()[1]}{root_path}/"
        if tokens is None or is_new:
            for line in _invitation(url, tokens, allows_acting=allow_control):
                say_live(line)
        else:
            say_live(f"{url}?token= with a token of {token_file}")
        return asyncio.run(_serve(session, rules, listener, _tls(certificate, key), root_path))


def _invitation(url: str, tokens: Tokens | None, *, allows_acting: bool) -> list[str]:
    if tokens is None:
        return [f"{url} (to look)"]
    lines = [f"{url}?token={tokens.look} (to look)"]
    if allows_acting:
        lines.append(f"{url}?token={tokens.act} (to act)")
    return lines


def _address(bind: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
    try:
        return ipaddress.ip_address("127.0.0.1" if bind == "localhost" else bind)
    except ValueError:
        fail(f"--bind: {bind} is not an IP address")


def _own_names(more: list[str] | tuple[str, ...]) -> frozenset[str]:
    host = socket.gethostname()
    names = {"localhost", host, f"{host}.local", *more}
    return frozenset(each.lower() for each in names)


def _tokens(file: Path | None) -> tuple[Tokens, bool]:
    """Return the tokens, and whether they are new."""
    from play_launch.cli.web.admission import Tokens  # noqa: PLC0415

    made = Tokens.made()
    if file is None:
        return made, True
    try:
        descriptor = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o600)
    except FileExistsError:
        return _kept(file), False
    except OSError as error:
        fail(f"--token-file: {file} cannot be written: {error.strerror}")
    with os.fdopen(descriptor, "w", encoding="ascii") as opened:
        opened.write(f"{made.look}\n{made.act}\n")
    return made, True


def _kept(file: Path) -> Tokens:
    from play_launch.cli.web.admission import Tokens  # noqa: PLC0415

    try:
        mode = file.stat().st_mode & 0o777
        if mode & 0o077:
            fail(f"--token-file: others can read {file} (mode {mode:o}); chmod 600 {file}")
        return Tokens.read(file.read_text("ascii"))
    except OSError as error:
        fail(f"--token-file: {file} cannot be read: {error.strerror}")
    except ValueError as error:
        fail(f"--token-file: {file}: {error}; remove it for new ones")


def require_nicegui() -> None:
    """End the process where the extra `web` is not installed."""
    if problem := _missing():
        fail(problem)


def _missing() -> str:
    for name in ("nicegui", "prometheus_client"):
        if find_spec(name) is None:
            return f"web needs {name}, which is not there; pip install 'play-launch-py[web]'"
    return ""


async def run_page(config: WebConfig, session: Path, show: Callable[[OutputLine], None]) -> None:
    """Keep the page of a session running until cancelled.

    What it prints goes to ``show``: tokens are for the user, and for no recording. What it
    complains about is logged.
    """
    from play_launch.cli.systemd_unit import program  # noqa: PLC0415 - another command's module

    if problem := _missing():
        _log.warning("the page is not shown: %s", problem)
        return

    def on_output(pid: int, stream: Stream, lines: Sequence[Line]) -> None:
        for line in lines:
            text = printable(line.text)
            if stream is Stream.STDOUT:
                stamp_ns = time.time_ns()
                show(
                    OutputLine(stamp_ns=stamp_ns, process="page", pid=pid, stream=stream, text=text)
                )
            else:
                _log.warning("the page: %s", text)

    words = ["--session", str(session), "--bind", config.bind, "--port", str(config.port)]
    words += ["--allow-control"] if config.allow_control else []
    words += ["--token-file", str(config.token_file)] if config.token_file else []
    words += [word for name in config.allow_host for word in ("--allow-host", name)]
    await run_companion(
        "the page is not shown",
        (str(program()), "web", *words),
        os.environ,
        guard_program=spawn_guard(),
        on_output=on_output,
    )


def _has_room(path: str) -> bool:
    """Whether a path may be asked for; pages that never opened a WebSocket go for another one."""
    from nicegui import Client  # noqa: PLC0415

    def opening() -> int:
        return sum(not each.has_socket_connection for each in Client.instances.values())

    if path not in Client.page_routes.values():
        return True
    if opening() >= _OPENING:
        Client.prune_instances(client_age_threshold=_OPENS_WITHIN)
    return opening() < _OPENING


def _listen(address: ipaddress.IPv4Address | ipaddress.IPv6Address, port: int) -> socket.socket:
    family = socket.AF_INET if address.version == 4 else socket.AF_INET6
    try:
        return socket.create_server((str(address), port), family=family)
    except OSError as error:
        fail(f"--bind {address} --port {port}: {error.strerror or error}; --port 0 takes any")


def _tls(certificate: Path | None, key: Path | None) -> ssl.SSLContext | None:
    if certificate is None or key is None:
        return None
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    try:
        context.load_cert_chain(certificate, key)
    except OSError as error:  # SSLError is one
        fail(f"--certificate {certificate} --key {key}: {error.strerror or error}")
    return context


async def _serve(
    session: str | None,
    rules: Rules,
    listener: socket.socket,
    tls: ssl.SSLContext | None,
    root_path: str,
) -> int:
    import uvicorn  # noqa: PLC0415
    from fastapi import FastAPI, Request, Response  # noqa: PLC0415
    from nicegui import app, ui  # noqa: PLC0415

    from play_launch.cli.web.admission import Access  # noqa: PLC0415
    from play_launch.cli.web.commands import CommandError, Commands  # noqa: PLC0415
    from play_launch.cli.web.metrics import CONTENT_TYPE, exposition  # noqa: PLC0415
    from play_launch.cli.web.page import declare  # noqa: PLC0415
    from play_launch.cli.web.watch import Watch  # noqa: PLC0415

    application = FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    watch = Watch(session)
    commands = Commands(session)

    @application.get("/metrics")
    async def metrics() -> Response:
        return Response(exposition(await watch.scrape()), media_type=CONTENT_TYPE)

    @application.get("/report/{name}")
    async def report(name: str) -> Response:
        watch.enter()
        try:
            text = await commands.report(name)
        except CommandError as error:
            return Response(f"{error}\n", status_code=503, media_type="text/plain")
        finally:
            watch.leave()
        # A browser loads it again then, so that a bring-up moves.
        headers = {"Refresh": _AGAIN} if watch.comes_up(name) else {}
        return Response(text, 200, headers, "text/html")

    async def missing(request: Request, error: Exception) -> Response:
        del request, error  # that of NiceGUI makes a page
        return Response("there is no such page\n", status_code=404, media_type="text/plain")

    app.add_exception_handler(404, missing)
    declare(watch, commands)
    ui.run_with(application, title="play-launch", dark=None, show_welcome_message=False)
    guarded: Any = Access(application, rules, _has_room)
    config = uvicorn.Config(
        guarded,
        log_level="warning",
        access_log=False,
        root_path=root_path,
        server_header=False,
        ws_max_size=_LONGEST_MESSAGE,
        timeout_graceful_shutdown=_CLOSING,
        proxy_headers=False,
    )
    config.load()
    config.ssl = tls
    async with asyncio.TaskGroup() as tasks:
        running = [tasks.create_task(each.run()) for each in (watch, commands)]
        await uvicorn.Server(config).serve(sockets=[listener])
        for each in running:
            each.cancel()
    return 0
