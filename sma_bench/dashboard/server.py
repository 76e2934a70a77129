"""The web server of the page: who may see it, files, a stream of updates, and the stop."""

import asyncio
import errno
import hmac
import ipaddress
import json
import secrets
import shlex
import socket
from importlib import resources
from typing import Any
from urllib.parse import urlsplit

import tornado.httpserver
import tornado.iostream
import tornado.netutil
import tornado.template
import tornado.web
import tornado.websocket

from sma_bench.border import TEXT, read_fields
from sma_bench.dashboard.live_state import Seen, quantity_table
from sma_bench.dashboard.stopping import WatchedBench, stop
from sma_bench.errors import InputError

UPDATE_PERIOD = 0.2
"""s between two updates of a page"""
_MOST_PAGES, _MOST_STRANGERS = 16, 32
_WORK_PATIENCE = 5.0
_IDLE = 30.0
"""s without a whole request"""
_LARGEST_REQUEST = 1 << 14
_FILES = {
    "dashboard.css": "text/css", "dashboard.js": "text/javascript", "uPlot.min.css": "text/css",
    "uPlot.min.js": "text/javascript",
}  # fmt: skip
_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
        "img-src data:; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
    ),
    "Cache-Control": "no-store",
    # Not no-referrer: a form without JavaScript would be sent from the origin "null".
    "Referrer-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Resource-Policy": "same-origin",
}


class Access:
    """Who may see a page served at `host`, and press its button: a token, and names that lead here.

    The token keeps other users and programs of the computer out. The Host header keeps out a web
    page whose own name was made to lead to this address after it had loaded (DNS rebinding); the
    Origin header keeps out every other web page.
    """

    def __init__(self, host: str) -> None:
        self.token = secrets.token_urlsafe(16)
        address = _address(host)
        self._everywhere = address is not None and address.is_unspecified
        own = socket.gethostname() if self._everywhere else host
        self._names = {"localhost", "127.0.0.1", "::1", own.lower()}

    def refusal(self, host: str | None, origin: str | None, token: str) -> str:
        """Why a request may not be answered, or "".

        Args:
            host, origin: the headers; None where there is none.
            token: what stands for it in the address.
        """
        try:
            name = (urlsplit(f"//{host}").hostname or "") if host else ""
        except ValueError:
            name = ""
        # A rebound name is a name: an address of numbers cannot be one.
        if name not in self._names and not (self._everywhere and _address(name)):
            return f"the page does not answer under the name {name!r}"
        # A browser sends Origin with what another page asks for, and with every POST.
        if origin is not None and urlsplit(origin).netloc != host:
            return "asked for by another web page"
        if not hmac.compare_digest(token.encode(), self.token.encode()):
            return "wrong token: the address is the one that sma-bench dashboard printed"
        return ""


def is_loopback(host: str) -> bool:
    """Whether only this computer reaches a server that listens on `host`."""
    address = _address(host)
    return host == "localhost" or (address is not None and address.is_loopback)


def _address(name: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(name)
    except ValueError:
        return None


class DashboardServer:
    """Serves one bench; `url`, with its token, is the only address that answers."""

    def __init__(self, bench: WatchedBench, title: str, host: str, port: int) -> None:
        """Listen; port 0 is any that is free.

        Raises:
            InputError: the address cannot be listened on.
        """
        try:
            sockets = tornado.netutil.bind_sockets(port, host)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            taken = getattr(error, "errno", None) == errno.EADDRINUSE
            hint = "; --port 0 takes any that is free" if taken else ""
            raise InputError(
                f"dashboard: cannot listen on {host} port {port}: {reason}{hint}"
            ) from None
        self.access = Access(host)
        name = f"[{host}]" if ":" in host else host
        self.url = f"http://{name}:{sockets[0].getsockname()[1]}/{self.access.token}/"
        self.bench, self.title = bench, title
        self.pages: set[_Live] = set()
        shared = {"server": self}
        application = tornado.web.Application(
            [
                (r"/([^/]+)/", _Page, shared),
                (r"/([^/]+)/live", _Live, shared),
                (r"/([^/]+)/stop", _Stop, shared),
                (r"/([^/]+)/work", _Work, shared),
                (r"/([^/]+)/([A-Za-z.]+)", _File, shared),
            ],
            default_handler_class=_Nothing, default_handler_args=shared,
            log_function=lambda _: None, websocket_ping_interval=5.0, websocket_ping_timeout=5.0,
        )  # fmt: skip
        self.http = _Server(
            application, max_header_size=_LARGEST_REQUEST, max_body_size=_LARGEST_REQUEST,
            idle_connection_timeout=_IDLE, body_timeout=_IDLE,
        )  # fmt: skip
        self.http.add_sockets(sockets)

    async def close(self) -> None:
        """Stop listening and cut what is open."""
        self.http.stop()
        await self.http.close_all_connections()


class _Server(tornado.httpserver.HTTPServer):
    """Keeps few connections open that have not shown the token: a stop must find room."""

    def initialize(self, *arguments: Any, **options: Any) -> None:
        """As HTTPServer's; it is no `__init__` there."""
        super().initialize(*arguments, **options)
        self.strangers: list[tornado.iostream.IOStream] = []

    def handle_stream(self, stream: tornado.iostream.IOStream, address: tuple) -> None:
        """A new connection; the oldest strangers make way for it."""
        self.strangers = [known for known in self.strangers if not known.closed()] + [stream]
        while len(self.strangers) > _MOST_STRANGERS:
            self.strangers.pop(0).close()
        super().handle_stream(stream, address)


class _Guarded(tornado.web.RequestHandler):
    """Answers nobody who may not see the page, whatever is asked for."""

    def initialize(self, server: DashboardServer) -> None:
        self.server = server

    def prepare(self) -> None:
        headers, http = self.request.headers, self.server.http
        token = self.path_args[0] if self.path_args else ""
        refusal = self.server.access.refusal(headers.get("Host"), headers.get("Origin"), token)
        if refusal:
            self.refuse(403, refusal)
        else:
            admitted = getattr(self.request.connection, "stream", None)
            http.strangers = [known for known in http.strangers if known is not admitted]

    def refuse(self, status: int, why: str) -> None:
        """End the answer with one line."""
        self.set_status(status)
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(f"{why}\n")

    def set_default_headers(self) -> None:
        self.clear_header("Server")
        for name, value in _HEADERS.items():
            self.set_header(name, value)

    def write_error(self, status_code: int, **_: Any) -> None:
        """One line, without what went wrong inside."""
        self.refuse(status_code, tornado.httputil.responses.get(status_code, "error"))


class _Nothing(_Guarded):
    def prepare(self) -> None:
        self.refuse(404, "the address lacks its token: use the one printed")


class _Page(_Guarded):
    def get(self, _: str) -> None:
        template = tornado.template.Template(_read("dashboard.html"), autoescape="xhtml_escape")
        quantities = json.dumps(quantity_table())
        self.finish(template.generate(title=self.server.title, quantities=quantities))


class _File(_Guarded):
    def get(self, _: str, name: str) -> None:
        if name not in _FILES:
            self.refuse(404, "no such file")
            return
        self.set_header("Content-Type", f"{_FILES[name]}; charset=utf-8")
        self.finish(_read(name))


class _Stop(_Guarded):
    async def post(self, _: str) -> None:
        self.finish(await stop(self.server.bench))


class _Work(_Guarded):
    """Starts a computation on records; nothing here drives a wire."""

    async def post(self, _: str) -> None:
        try:
            body = self.request.body.decode(errors="replace")
            asked = read_fields(body, {"kind": TEXT, "records": TEXT}, "work")
            begun = self.server.bench.start_work(asked["kind"], shlex.split(asked["records"]))
        except ValueError as error:
            self.refuse(400, str(error))
            return
        try:
            good, said = await asyncio.wait_for(asyncio.wrap_future(begun), _WORK_PATIENCE)
        except TimeoutError:
            good, said = False, "the node does not answer"
        self.finish({"begun": good, "said": said})


class _Live(_Guarded, tornado.websocket.WebSocketHandler):
    """Sends what is new five times a second, to a slow page less often."""

    def open(self, *_: str) -> None:
        if len(self.server.pages) >= _MOST_PAGES:
            self.close(reason="too many pages are open")
            return
        self.server.pages.add(self)
        self._task = asyncio.create_task(self._send())

    def on_close(self) -> None:
        self.server.pages.discard(self)

    def on_message(self, _: str | bytes) -> None:
        """A page has nothing to say here."""

    async def _send(self) -> None:
        seen = Seen()
        try:
            while self in self.server.pages:
                await self.write_message(json.dumps(self.server.bench.state.update(seen)))
                await asyncio.sleep(UPDATE_PERIOD)
        except tornado.websocket.WebSocketClosedError:
            self.server.pages.discard(self)


def _read(name: str) -> bytes:
    return resources.files("sma_bench.dashboard").joinpath(name).read_bytes()
