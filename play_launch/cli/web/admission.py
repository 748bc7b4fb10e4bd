"""Decides which HTTP requests and WebSockets may come in: ASGI middleware.

A request has this server's name or an address as `Host`, against DNS rebinding, and comes from a
page of this server, if it has an `Origin`. Where tokens are demanded, it has one: in its cookie,
which the address with `?token=` sets, or as `Authorization: Bearer`; one is to look, one to act.
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
import time
from enum import IntEnum
from http.cookies import CookieError, SimpleCookie
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import parse_qs, urlsplit

from msgspec import Struct, field

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterable, MutableMapping

    Scope = MutableMapping[str, Any]
    Message = MutableMapping[str, Any]
    Receive = Callable[[], Awaitable[Message]]
    Send = Callable[[Message], Awaitable[None]]
    Application = Callable[[Scope, Receive, Send], Awaitable[None]]

_COOKIE: Final = "play_launch_token_"
"""With the port behind it: browsers send cookies to all ports of a host."""
RIGHT: Final = "play_launch.right"
"""Key of the scope under which the application finds the `Right` of a request."""
_REQUESTS_PER_SECOND: Final = 50.0
_REQUESTS_AT_ONCE: Final = 600.0
"""A page is some sixty files, and a browser fetches them at once."""
_FAILURES_PER_SECOND: Final = 1.0
_FAILURES_AT_ONCE: Final = 10.0
_TOKEN_BYTES: Final = 24
_SHORTEST_TOKEN: Final = 16
_SECURITY: Final = (
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
)
_POLICY_VIOLATION: Final = 1008


class Right(IntEnum):
    """What a visitor may do."""

    NOTHING = 0
    LOOK = 1
    ACT = 2


class Tokens(Struct, frozen=True):
    """The secrets of a server."""

    look: str
    act: str

    @classmethod
    def made(cls) -> Tokens:
        return cls(secrets.token_urlsafe(_TOKEN_BYTES), secrets.token_urlsafe(_TOKEN_BYTES))

    @classmethod
    def read(cls, text: str) -> Tokens:
        """Read two lines: the token for looking, the one for acting; raises ValueError."""
        lines = text.split()
        if len(lines) != 2 or lines[0] == lines[1]:
            raise ValueError("two different tokens are expected, each in a line")
        if min(map(len, lines)) < _SHORTEST_TOKEN:
            raise ValueError(f"a token needs at least {_SHORTEST_TOKEN} characters")
        return cls(*lines)

    def right(self, token: str) -> Right:
        given = token.encode("utf-8", "replace")
        # Both are compared always, and in constant time.
        looks = hmac.compare_digest(given, self.look.encode())
        acts = hmac.compare_digest(given, self.act.encode())
        return Right.ACT if acts else Right.LOOK if looks else Right.NOTHING


class Rules(Struct, frozen=True):
    """What is demanded of visitors.

    Attributes:
        hosts: Names of this server, without port, lower case.
        tokens: None: none are demanded.
        allows_acting: Otherwise no visitor may act, with whatever token.
        clients: Most WebSockets at a time; each open page has one.
        is_secure: Whether visitors come by TLS.
    """

    hosts: frozenset[str]
    tokens: Tokens | None
    allows_acting: bool
    clients: int
    is_secure: bool


class _Bucket(Struct):
    """A limit of a rate, which permits a burst."""

    per_second: float
    most: float
    left: float = 0.0
    at: float = field(default_factory=time.monotonic)

    def take(self) -> bool:
        now = time.monotonic()
        self.left = min(self.left + (now - self.at) * self.per_second, self.most)
        self.at = now
        if self.left < 1:
            return False
        self.left -= 1
        return True


class Refusal(Exception):  # noqa: N818 - an answer, not a failure
    """A request is answered with this status and text."""

    def __init__(self, status: int, text: str) -> None:
        super().__init__(text)
        self.status = status


class Access:
    """The application behind its rules."""

    def __init__(
        self, application: Application, rules: Rules, has_room: Callable[[str], bool]
    ) -> None:
        """``has_room``: whether what is at a path may be made, as a page takes memory."""
        self._application = application
        self._rules = rules
        self._has_room = has_room
        self._requests = _Bucket(_REQUESTS_PER_SECOND, _REQUESTS_AT_ONCE, _REQUESTS_AT_ONCE)
        self._failures = _Bucket(_FAILURES_PER_SECOND, _FAILURES_AT_ONCE, _FAILURES_AT_ONCE)
        self._clients = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._application(scope, receive, send)
            return
        is_socket = scope["type"] == "websocket"
        try:
            token = self._visited_with(scope) if not is_socket else None
            right = self._right(scope, token)
        except Refusal as refusal:
            await (_close if is_socket else _answer)(send, refusal)
            return
        if token is not None:
            await self._set_cookie(scope, send, token)
            return
        scope[RIGHT] = right
        self._clients += is_socket
        has_left = False

        async def heard() -> Message:
            nonlocal has_left
            message = await receive()
            has_left |= message["type"] == "http.disconnect"
            return message

        try:
            await self._application(scope, heard, _with_security(send))
        except RuntimeError:
            # Of a middleware, which misses the answer of a request that is cancelled for that.
            if not has_left:
                raise
        finally:
            self._clients -= is_socket

    def _visited_with(self, scope: Scope) -> str | None:
        """Return the token of the address, if it has one."""
        query = parse_qs(scope.get("query_string", b"").decode("latin-1"))
        return query["token"][0] if self._rules.tokens and "token" in query else None

    def _right(self, scope: Scope, token: str | None) -> Right:
        """Return what a visitor may do; raises Refusal."""
        if scope["type"] == "websocket" and self._clients >= self._rules.clients:
            raise Refusal(503, "too many pages of this session are open")
        if not self._requests.take():
            raise Refusal(429, "too many requests")
        headers = [(name.lower(), value.decode("latin-1")) for name, value in scope["headers"]]
        hosts = [value for name, value in headers if name == b"host"]
        if len(hosts) != 1 or not self._is_ours(_name_of(hosts[0])):
            raise Refusal(
                421, f"this server is not {', '.join(hosts) or 'nameless'}; see --allow-host"
            )
        for name, origin in headers:
            if name == b"origin" and origin.lower().partition("://")[2] != hosts[0].lower():
                raise Refusal(403, "pages of other servers may not ask this one")
        right = self._known(token, headers, _cookie_of(scope))
        path = str(scope["path"]).removeprefix(scope.get("root_path", ""))
        if scope["type"] == "http" and not self._has_room(path):
            raise Refusal(503, "too many pages of this session are being opened")
        return right if self._rules.allows_acting else min(right, Right.LOOK)

    def _is_ours(self, name: str) -> bool:
        """Whether a visitor meant this server: rebinding needs a name, so any address will do."""
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return name in self._rules.hosts
        return True

    def _known(self, token: str | None, headers: Iterable[tuple[bytes, str]], cookie: str) -> Right:
        if self._rules.tokens is None:
            return Right.ACT
        given = token if token is not None else _bearer(headers) or _cookie(headers, cookie)
        right = self._rules.tokens.right(given) if given else Right.NOTHING
        if right is Right.NOTHING:
            if given and not self._failures.take():
                raise Refusal(429, "too many wrong tokens")
            raise Refusal(401, "open the address with the token that `play-launch web` has printed")
        return right

    async def _set_cookie(self, scope: Scope, send: Send, token: str) -> None:
        # SameSite=Strict: after a redirect from a foreign link the cookie would not be sent.
        body = f'<meta http-equiv="refresh" content="0;url={_quoted(scope["path"])}">'.encode()
        cookie = f"{_cookie_of(scope)}={token}; HttpOnly; SameSite=Strict; Path=/; Max-Age=2592000"
        if self._rules.is_secure:
            cookie += "; Secure"
        headers = [
            (b"content-type", b"text/html; charset=utf-8"),
            (b"cache-control", b"no-store"),
            (b"set-cookie", cookie.encode("latin-1", "replace")),
            *_SECURITY,
        ]
        await send({"type": "http.response.start", "status": 200, "headers": headers})
        await send({"type": "http.response.body", "body": body})


def _name_of(host: str) -> str:
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


def _quoted(path: str) -> str:
    """Return the path of this server, not of another one (`//elsewhere`), for an attribute."""
    safe = "".join(each for each in path if each.isalnum() or each in "/-_.~")
    return "/" + safe.lstrip("/")


def _bearer(headers: Iterable[tuple[bytes, str]]) -> str:
    """Return the token of a program, such as Prometheus."""
    for name, value in headers:
        scheme, _, token = value.partition(" ")
        if name == b"authorization" and scheme.lower() == "bearer":
            return token.strip()
    return ""


def _cookie_of(scope: Scope) -> str:
    return f"{_COOKIE}{scope['server'][1]}"


def _cookie(headers: Iterable[tuple[bytes, str]], wanted: str) -> str:
    for name, value in headers:
        if name == b"cookie":
            cookies: SimpleCookie = SimpleCookie()
            try:
                cookies.load(value)
            except CookieError:
                return ""
            if wanted in cookies:
                return cookies[wanted].value
    return ""


def _with_security(send: Send) -> Send:
    async def wrapped(message: Message) -> None:
        if message["type"] == "http.response.start":
            message["headers"] = [*message.get("headers", ()), *_SECURITY]
        await send(message)

    return wrapped


async def _answer(send: Send, refusal: Refusal) -> None:
    headers = [(b"content-type", b"text/plain; charset=utf-8"), *_SECURITY]
    await send({"type": "http.response.start", "status": refusal.status, "headers": headers})
    await send({"type": "http.response.body", "body": f"{refusal}\n".encode()})


async def _close(send: Send, refusal: Refusal) -> None:
    # Before it was accepted: the server answers the handshake with 403.
    await send({"type": "websocket.close", "code": _POLICY_VIOLATION, "reason": str(refusal)})
