"""Access to the page: none without its token, from another web page or under another name."""

import http.client
import json
import socket
import subprocess
import sys
from contextlib import ExitStack, closing
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from stand_in import StandIn, served

from sma_bench.dashboard.server import Access, DashboardServer, is_loopback
from sma_bench.errors import InputError

UPGRADE = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13",
           "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA=="}  # fmt: skip


@pytest.fixture
def bench():
    return StandIn()


@pytest.fixture
def url(bench):
    with served(bench, title="/<b>bench</b>") as found:
        yield found


def ask(url, method="GET", name="", token=None, body=None, **headers):
    """Status, headers and text of an answer."""
    parts = urlsplit(url)
    connection = http.client.HTTPConnection(parts.hostname, parts.port, timeout=30.0)
    path = parts.path if token is None else f"/{token}/"
    connection.request(method, path + name, body, headers)
    with closing(connection), connection.getresponse() as response:
        # An open stream has no end to read to.
        text = "" if response.status == 101 else response.read().decode()
        return response.status, dict(response.getheaders()), text


def test_the_printed_address_shows_the_page_with_its_texts_escaped(url):
    status, headers, text = ask(url)
    assert status == 200
    assert "<b>bench" not in text and "&lt;b&gt;bench" in text
    for rule in ("default-src 'none'", "frame-ancestors 'none'"):
        assert rule in headers["Content-Security-Policy"]
    assert headers["Referrer-Policy"] == "same-origin" and "Server" not in headers
    assert "http" not in text  # nothing from elsewhere
    for name in ("dashboard.css", "dashboard.js", "uPlot.min.css", "uPlot.min.js"):
        assert ask(url, name=name)[0] == 200, name


def test_tokens_loopback_and_names_to_answer_under_and_a_port_that_is_taken(bench):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        said = f"cannot listen on 127.0.0.1 port {port}: Address already in use; --port 0 takes any"
        with pytest.raises(InputError, match=said):
            DashboardServer(bench, "/bench", "127.0.0.1", port)
    tokens = {Access("127.0.0.1").token for _ in range(20)}
    assert len(tokens) == 20 and all(len(token) >= 22 for token in tokens)
    assert all(map(is_loopback, ("127.0.0.1", "127.0.0.2", "::1", "localhost")))
    assert not any(map(is_loopback, ("0.0.0.0", "192.168.1.7", "lab.example", "::")))
    everywhere = ("192.168.1.7:8642", "[fe80::1]:8642", socket.gethostname(), "localhost")
    for bound, host, answers in (
        *(("0.0.0.0", host, True) for host in everywhere), ("0.0.0.0", "evil.example", False),
        ("192.168.1.7", "192.168.1.7:8642", True), ("192.168.1.7", "192.168.1.8:8642", False),
    ):  # fmt: skip
        access = Access(bound)
        assert (access.refusal(host, None, access.token) == "") == answers, host


def test_without_its_token_under_another_name_or_from_another_page_nothing_is_answered(bench, url):
    wrong = urlsplit(url).path.strip("/")[:-1] + "_"
    hosts = ("evil.example:8642", "127.0.0.1.evil.example", "", "[::")
    foreign = [{"Host": host} for host in hosts]
    origins = "http://evil.example", "null", "http://["
    foreign += [{head: one} for head in ("Origin", "Sec-WebSocket-Origin") for one in origins]
    for name in ("", "dashboard.js", "live", "stop"):
        method = "POST" if name == "stop" else "GET"
        for token in (wrong, "%00", ".."):
            status, _, text = ask(url, method, name, token, **UPGRADE)
            assert status in (403, 404), (name, token)
            assert "STOP" not in text and "import" not in text
        for headers in foreign if name != "dashboard.js" else ():
            refused = (403,) if "Host" not in headers else (400, 403)
            assert ask(url, method, name, **UPGRADE, **headers)[0] in refused, (name, headers)
    assert ask(url.replace(urlsplit(url).path, "/"))[0] == 404
    assert bench.stops == bench.zeros == 0


def test_its_own_page_may_listen_stop_by_a_post_and_have_records_worked_on(bench, url):
    origin = "http://" + urlsplit(url).netloc
    assert ask(url, "GET", "live", Origin=origin, **UPGRADE)[0] == 101
    assert ask(url, Host="localhost:9000")[0] == 200  # a forwarded port is this computer too
    assert ask(url, "GET", "stop")[0] == 405
    assert ask(url, "POST", "stop", **{"Content-Length": str(1 << 20)})[0] in (400, 413)
    assert bench.stops == 0
    bench.volts = {}
    status, headers, text = ask(url, "POST", "stop", Origin=origin)
    assert status == 200 and headers["Content-Type"].startswith("application/json")
    assert bench.stops == 1 and json.loads(text)["stopped"] is False
    body = json.dumps({"kind": "diagnose", "records": "monday 'tue sday'"})
    assert ask(url, "POST", "work", Origin="http://elsewhere", body=body)[0] == 403
    for bad in ("", "[]", '{"kind": "diagnose"}', '{"kind": "diagnose", "records": "\'"}'):
        assert ask(url, "POST", "work", Origin=origin, body=bad)[0] == 400
    assert bench.work == []
    status, _, text = ask(url, "POST", "work", Origin=origin, body=body)
    assert (status, json.loads(text)) == (200, {"begun": True, "said": "begun"})
    assert bench.work == [("diagnose", ["monday", "tue sday"])]


SERVE = """
import resource, sys
resource.setrlimit(resource.RLIMIT_NOFILE, (256, 256))
from stand_in import StandIn, served
bench = StandIn()
bench.volts = {}
with served(bench) as url:
    print(url, flush=True)
    sys.stdin.read()
    print(bench.stops)
"""


def test_a_crowd_without_the_token_does_not_keep_the_stop_out():
    """Connections that say nothing, and ones that ask for nothing they may have."""
    with ExitStack() as crowd:
        server = crowd.enter_context(subprocess.Popen(
            [sys.executable, "-c", SERVE], cwd=Path(__file__).parent, stdin=subprocess.PIPE,
            stdout=subprocess.PIPE, text=True,
        ))  # fmt: skip
        crowd.callback(server.kill)
        url = server.stdout.readline().strip()
        address = urlsplit(url).hostname, urlsplit(url).port
        for k in range(253):
            stranger = crowd.enter_context(socket.create_connection(address, timeout=30.0))
            if k % 2:
                stranger.sendall(b"GET /x/ HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        for _ in range(3):
            status, _, text = ask(url, "POST", "stop")
            assert status == 200 and json.loads(text)["stopped"] is False
        assert server.communicate("", timeout=30.0)[0].strip() == "3"
