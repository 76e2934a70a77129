"""The web server of the page: access, files, a stream of updates, and the stop."""

import asyncio
import errno
import hmac
import ipaddress
import json
import math
import secrets
import shlex
import socket
from collections.abc import Mapping
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
from sma_bench.dashboard.live_state import QUANTITIES, Seen, WireVoltage
from sma_bench.errors import InputError

# The stop.
_STOP_TIMEOUT = 3.0  # s
_STAYS_OFF = 1.0  # s of 0 V: longer than a command timeout, and than most pauses between pulses
_SILENT = 1.0  # s without a message after which a wire no longer belongs to the bench
_LEAST_ADVANCE = 0.1  # of stamps, per wall time: a simulation may be slow, but not frozen
_LOOK, _REPEAT = 0.005, 0.02  # s between two checks; between two commands of 0 V
UPDATE_PERIOD = 0.2  # s between two updates of a page
_MOST_PAGES, _MOST_STRANGERS = 16, 32
_IDLE = 30.0  # s without a whole request
_LARGEST_REQUEST = 1 << 14  # bytes
_FILES = {"dashboard.css": "text/css", "dashboard.js": "text/javascript",
          "uPlot.min.css": "text/css", "uPlot.min.js": "text/javascript"}
_HEADERS = {
    "Content-Security-Policy":
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
        "img-src data:; form-action 'self'; base-uri 'none'; frame-ancestors 'none'",
    "Cache-Control": "no-store",
    # Not no-referrer: a form without JavaScript would be sent from the origin "null".
    "Referrer-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Resource-Policy": "same-origin"}


class Access:
    """Who may see a page served at `host` and press its button. The token keeps out other users and
    programs, the check of the Host header DNS rebinding, that of Origin all other web pages."""

    def __init__(self, host: str) -> None:
        self.token = secrets.token_urlsafe(16)
        address = _address(host)
        self._everywhere = address is not None and address.is_unspecified
        own = socket.gethostname() if self._everywhere else host
        self._names = {"localhost", "127.0.0.1", "::1", own.lower()}

    def refusal(self, host: str | None, origin: str | None, token: str) -> str:
        """Why a request is refused, or ""; None: no such header; `token`: from the path."""
        try:
            name = (urlsplit(f"//{host}").hostname or "") if host else ""
        except ValueError:
            name = ""
        # DNS rebinding needs a name: a numeric address is safe.
        if name not in self._names and not (self._everywhere and _address(name)):
            return f"the page does not answer under the name {name!r}"
        # Browsers send Origin with requests of other pages, and with every POST.
        if origin is not None and origin.partition("://")[2] != host:
            return "request of another web page"
        if not hmac.compare_digest(token.encode(), self.token.encode()):
            return "wrong token: the address is the one that sma-bench dashboard printed"
        return ""


def is_loopback(host: str) -> bool:
    """True if only this computer can reach a server that listens on `host`."""
    address = _address(host)
    return host == "localhost" or (address is not None and address.is_loopback)


def _address(name: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(name)
    except ValueError:
        return None


class DashboardServer:
    """Serves one bench (see `stop`); only `url`, which contains the token, answers."""

    def __init__(self, bench: Any, title: str, host: str, port: int) -> None:
        """Listen; port 0 is any free one. Raises InputError: the address is not available."""
        try:
            sockets = tornado.netutil.bind_sockets(port, host)
        except OSError as error:
            reason = error.strerror or str(error)
            if error.errno == errno.EADDRINUSE:
                reason += "; --port 0 takes any that is free"
            raise InputError(f"dashboard: cannot listen on {host} port {port}: {reason}") from None
        self.access = Access(host)
        name = f"[{host}]" if ":" in host else host
        self.url = f"http://{name}:{sockets[0].getsockname()[1]}/{self.access.token}/"
        self.bench, self.title = bench, title
        self.pages: set[_Live] = set()
        shared = {"server": self}
        pages = {"": _Page, "live": _Live, "stop": _Stop, "work": _Work, "([A-Za-z.]+)": _File}
        application = tornado.web.Application(
            [(f"/([^/]+)/{name}", handler, shared) for name, handler in pages.items()],
            default_handler_class=_Nothing, default_handler_args=shared,
            log_function=lambda _: None, websocket_ping_interval=5.0, websocket_ping_timeout=5.0)
        self.http = _Server(application, max_header_size=_LARGEST_REQUEST,
                            max_body_size=_LARGEST_REQUEST, idle_connection_timeout=_IDLE,
                            body_timeout=_IDLE)
        self.http.add_sockets(sockets)

    async def close(self) -> None:
        self.http.stop()
        await self.http.close_all_connections()


class _Server(tornado.httpserver.HTTPServer):
    """Limits connections that have not shown the token, so that a stop always finds room."""

    strangers: tuple[tornado.iostream.IOStream, ...] = ()

    def handle_stream(self, stream: tornado.iostream.IOStream, address: tuple) -> None:
        """A new connection; closes the oldest of those without the token."""
        known = [known for known in self.strangers if not known.closed()]
        for oldest in known[: -(_MOST_STRANGERS - 1)]:
            oldest.close()
        self.strangers = (*known[-(_MOST_STRANGERS - 1) :], stream)
        super().handle_stream(stream, address)


class _Guarded(tornado.web.RequestHandler):
    """Refuses every request without access."""

    def initialize(self, server: DashboardServer) -> None:
        self.server = server

    def prepare(self) -> None:
        headers, http = self.request.headers, self.server.http
        token = self.path_args[0] if self.path_args else ""
        origin = headers.get("Origin", headers.get("Sec-WebSocket-Origin"))  # of old browsers
        if refusal := self.server.access.refusal(headers.get("Host"), origin, token):
            self.refuse(403, refusal)
        else:
            admitted = getattr(self.request.connection, "stream", None)
            http.strangers = tuple(known for known in http.strangers if known is not admitted)

    def refuse(self, status: int, why: str) -> None:
        self.set_status(status)
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(f"{why}\n")

    def set_default_headers(self) -> None:
        self.clear_header("Server")
        for name, value in _HEADERS.items():
            self.set_header(name, value)

    def write_error(self, status_code: int, **_: Any) -> None:
        """One line, without internal details."""
        self.refuse(status_code, tornado.httputil.responses.get(status_code, "error"))


class _Nothing(_Guarded):
    def prepare(self) -> None:
        self.refuse(404, "no token in the address: use the one that sma-bench dashboard printed")


class _Page(_Guarded):
    def get(self, _: str) -> None:
        template = tornado.template.Template(_read("dashboard.html"), autoescape="xhtml_escape")
        table = {name: {"title": q.title, "unit": q.unit} for name, q in QUANTITIES.items()}
        self.finish(template.generate(title=self.server.title, quantities=json.dumps(table)))


class _File(_Guarded):
    def get(self, _: str, name: str) -> None:
        if kind := _FILES.get(name):
            self.set_header("Content-Type", f"{kind}; charset=utf-8")
            self.finish(_read(name))
        else:
            self.refuse(404, "no such file")


class _Stop(_Guarded):
    async def post(self, _: str) -> None:
        self.finish(await stop(self.server.bench))


class _Work(_Guarded):
    """Starts a computation on records; it drives no wire."""

    async def post(self, _: str) -> None:
        try:
            body = self.request.body.decode(errors="replace")
            asked = read_fields(body, {"kind": TEXT, "records": TEXT}, "work")
            records = shlex.split(asked["records"])
        except ValueError as error:
            self.refuse(400, str(error))
            return
        try:
            await asyncio.to_thread(self.server.bench.start_work, asked["kind"], records)
            self.finish({"begun": True, "said": "begun"})
        except InputError as error:
            self.finish({"begun": False, "said": str(error)})


class _Live(_Guarded, tornado.websocket.WebSocketHandler):
    """Sends changes five times a second, less often to a slow page."""

    def open(self, *_: str) -> None:
        if len(self.server.pages) >= _MOST_PAGES:
            self.close(reason="too many pages are open")
            return
        self.server.pages.add(self)
        self._task = asyncio.create_task(self._send())

    def on_close(self) -> None:
        self.server.pages.discard(self)

    def on_message(self, _: str | bytes) -> None:
        """Messages from pages are ignored."""

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


class Wires:
    """Judges by the voltages whether a stop requested at `begin` (s of the state's clock) worked;
    `before`: the voltages before it. Only readings count whose stamps, on their source's clock, are
    later than those before and go on: a replayed bag or a frozen driver confirms nothing."""

    def __init__(self, begin: float, voltages: Mapping[str, WireVoltage],
                 before: Mapping[str, WireVoltage], foreign: Mapping[str, str]) -> None:
        """`foreign`: wires whose voltage is from a node that takes no commands, and that node."""
        self._begin = begin
        self.live = {p: v for p, v in voltages.items() if v.last_message >= begin - _SILENT}
        self._foreign = {place: foreign[place] for place in self.live if place in foreign}
        gone = {place: v.stamp - before[place].stamp if place in before else math.inf
                for place, v in self.live.items()}
        self._read = {place: v for place, v in self.live.items() if v.heard >= begin
                      and gone[place] > _LEAST_ADVANCE * (v.heard - begin)}
        # Any reading can show that a voltage is on; only new ones that it is off.
        self.on = [place for place, v in self.live.items() if math.isinf(v.off_since)]
        self.unclear = bool(self.on) or not self.live or self._read.keys() != self.live.keys()

    def _off_for(self, wire: WireVoltage) -> float:
        return wire.heard - max(wire.off_since, self._begin)

    @property
    def stay_off(self) -> bool:
        """True if every live wire was read at 0 V, and nothing else, for long enough."""
        known = bool(self.live) and not self._foreign and self._read.keys() == self.live.keys()
        return known and all(self._off_for(v) >= _STAYS_OFF for v in self.live.values())

    def sentence(self, asked: bool) -> str:
        """The result for the user; `asked`: stop services of nodes were called."""
        silent = ", ".join(sorted(self.live.keys() - self._read.keys()))
        # Wires read for long enough, but not off for as long.
        late = ", ".join(sorted(place for place, v in self._read.items()
                                if self._off_for(v) < _STAYS_OFF <= v.heard - self._begin))
        if self.on:
            still = ", ".join(f"{place} {self.live[place].volts:.2f} V" for place in self.on)
            return f"NOT STOPPED, voltage is on: {still}. Use the emergency stop of the bench."
        if self._foreign:
            whose = ", ".join(f"{p} ({node})" for p, node in sorted(self._foreign.items()))
            return f"Not confirmed: nodes that take no commands publish {whose}. Look at the bench."
        if silent:
            return f"Not confirmed: no reading since the request from {silent}. Look at the bench."
        if self.stay_off:
            wires = "the wire" if len(self.live) == 1 else f"all {len(self.live)} wires"
            took = max(0.0, *(v.off_since - self._begin for v in self.live.values()))
            return (f"0 V read on {wires}, {1e3 * took:.0f} ms after the request, and nothing else "
                    f"for {_STAYS_OFF:g} s.")
        if late:
            ago = f"less than {_STAYS_OFF:g} s ago"
            return f"NOT STOPPED, voltage was on {ago}: {late}. Use the emergency stop."
        if self.live:
            return "Not confirmed: too few readings since the request. Look at the bench."
        if asked:
            return "Not confirmed: stop was sent, but no voltage is read here. Look at the bench."
        return "Nothing to stop: no node answers here and no voltage is read. Look at the bench."


async def stop(bench: Any) -> dict[str, Any]:
    """Stop a bench (such as `ros.dashboard.DashboardNode`) and check the result. 0 V is commanded
    until the voltages are gone, so that a commander without a stop service is stopped, too.
    Returns `stopped`: every live wire was read at 0 V and stayed there, and no node reports a
    flowing current; `said`: a sentence; `voltages` [V]; `answers` of the nodes."""
    clock = bench.state.clock
    begin = commanded = clock()
    before = bench.state.voltages()
    bench.state.stop_asked()
    bench.send_zero()
    futures = bench.send_stop()
    while True:
        voltages, now = bench.state.voltages(), clock()
        before = voltages | before  # for a wire that appeared since: its first reading
        wires = Wires(begin, voltages, before, bench.state.foreign())
        no_wires = not wires.live and now > begin + _SILENT
        answered = all(future.done() for future in futures.values())
        if (answered and (wires.stay_off or no_wires)) or now > begin + _STOP_TIMEOUT:
            break
        if wires.unclear and now > commanded + _REPEAT:
            commanded = now
            bench.send_zero()
        await asyncio.sleep(_LOOK)
    if wires.stay_off:
        bench.state.stop_confirmed(wires.live)
    answers = []
    for node, future in sorted(futures.items()):
        answer = future.result() if future.done() else None
        text = str(answer.message) if answer else "no answer"
        answers.append({"node": node, "success": bool(answer and answer.success), "message": text})
    flowing = ", ".join(bench.state.flowing())
    plug = f"PULL THE PLUG: current flows with every output off, reported by {flowing}."
    return {"stopped": wires.stay_off and not flowing,
            "said": plug if flowing else wires.sentence(bool(futures)),
            "voltages": {place: round(v.volts, 3) for place, v in wires.live.items()
                         if math.isfinite(v.volts)},
            "answers": answers}
