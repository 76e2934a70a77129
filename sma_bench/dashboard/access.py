"""Who may see the page and press its button: a token, and names that lead here.

The token keeps other users and programs of the computer out. The Host header keeps out a web page
whose own name was made to lead to this address after it had loaded (DNS rebinding); the Origin
header keeps out every other web page.
"""

import hmac
import ipaddress
import secrets
import socket
from urllib.parse import urlsplit

_TOKEN_BYTES = 16
_LOOPBACK = frozenset({"localhost", "127.0.0.1", "::1"})


class Access:
    """What is allowed on a page served at `host`, the address that it listens on."""

    def __init__(self, host: str) -> None:
        self.token = secrets.token_urlsafe(_TOKEN_BYTES)
        self._everywhere = _is_unspecified(host)
        own = {socket.gethostname().lower()} if self._everywhere else {host.lower()}
        self._names = _LOOPBACK | own

    def refusal(self, host: str | None, origin: str | None, token: str) -> str:
        """Why a request may not be answered, or "".

        Args:
            host, origin: the headers; None where there is none.
            token: what stands for it in the address.
        """
        name = _name(host)
        if not self._is_own(name):
            return f"the page does not answer under the name {name!r}"
        # A browser sends Origin with what another page asks for, and with every POST.
        if origin is not None and urlsplit(origin).netloc != host:
            return "asked for by another web page"
        if not hmac.compare_digest(token.encode(), self.token.encode()):
            return "wrong token: the address is the one that sma-bench dashboard printed"
        return ""

    def _is_own(self, name: str) -> bool:
        # A rebound name is a name: an address of numbers cannot be one.
        return name in self._names or (self._everywhere and _is_address(name))


def is_loopback(host: str) -> bool:
    """Whether only this computer reaches a server that listens on `host`."""
    return host == "localhost" or (_is_address(host) and ipaddress.ip_address(host).is_loopback)


def _is_unspecified(host: str) -> bool:
    return _is_address(host) and ipaddress.ip_address(host).is_unspecified


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _name(host: str | None) -> str:
    """The name in a Host header, without port and brackets; "" where there is none."""
    try:
        return (urlsplit(f"//{host}").hostname or "") if host else ""
    except ValueError:
        return ""
