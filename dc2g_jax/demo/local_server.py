"""Protection of a server on this machine from other web sites that the user's browser shows."""

import re
import secrets
from urllib.parse import urlsplit

from starlette.datastructures import MutableHeaders
from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from dc2g_jax.runtime import InputError, short

#: Largest body of a request, in bytes. Browsers say the length of every body; the server holds them to it.
LARGEST_BODY = 1_000_000

#: Headers of every answer: nothing from other hosts is loaded, no other site shows the page in a frame, and files are
#: what they say they are. NiceGUI's page has scripts and styles in it, and compiles templates.
_ANSWER_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
        "img-src 'self' data:; font-src 'self' data:; object-src 'none'; base-uri 'none'; form-action 'none'; "
        "frame-ancestors 'none'"
    ),
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
}


def check_token(token: str) -> None:
    """Check that a token can stand in an address and in a cookie; empty for none.

    Raises:
      InputError: it cannot.
    """
    if not re.fullmatch(r"[A-Za-z0-9_-]*", token):
        raise InputError(f"--token {short(token)}: give letters without accents, digits, - and _ only")


class OwnOriginOnly:
    """Middleware that refuses requests and web sockets of pages from another origin, and large bodies.

    A page of the server itself sends the server's own address as its `Origin`. Programs other than browsers send none.
    The `Host` must be checked too, as by Starlette's `TrustedHostMiddleware`.

    With a token, as Jupyter has one, other users of the machine are refused: the first address must end in
    `?token=...`, and a cookie holds it from then on. Browsers send a cookie to all ports of a machine, so its name has
    the port.

    Args:
      app: the application behind it.
      token: the token, see `check_token`; empty for none.
      port: port of the server.
    """

    def __init__(self, app: ASGIApp, *, token: str, port: int):
        self.app, self._token, self._cookie = app, token.encode(), f"dc2g_token_{port}"

    def _knows_token(self, request: HTTPConnection) -> bool:
        """Whether a request has the token in its address or its cookie."""
        given = request.query_params.get("token", ""), request.cookies.get(self._cookie, "")
        return any(secrets.compare_digest(one.encode(), self._token) for one in given)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuse a request, or pass it on."""
        if scope["type"] == "lifespan":
            return await self.app(scope, receive, send)

        cookie = ""

        async def answer(message: Message) -> None:
            if message["type"].endswith("http.response.start"):  # also of a web socket that is refused
                MutableHeaders(scope=message).update(_ANSWER_HEADERS)
                if cookie:
                    MutableHeaders(scope=message).append("set-cookie", cookie)
            await send(message)

        request = HTTPConnection(scope)
        headers, origin = request.headers, request.headers.get("origin")
        if origin is not None and urlsplit(origin).netloc != headers.get("host"):
            return await PlainTextResponse("pages of other origins are refused", 403)(scope, receive, answer)
        if self._token:
            if not self._knows_token(request):
                refused = "open the address with ?token= that dc2g demo has printed"
                return await PlainTextResponse(refused, 403)(scope, receive, answer)
            cookie = f"{self._cookie}={self._token.decode()}; HttpOnly; SameSite=Strict; Path=/"
        if scope["type"] == "websocket":
            return await self.app(scope, receive, send)
        if "transfer-encoding" in headers or int(headers.get("content-length", 0)) > LARGEST_BODY:
            return await PlainTextResponse("the body is too large, or does not say its length", 413)(
                scope, receive, answer
            )
        await self.app(scope, receive, answer)
