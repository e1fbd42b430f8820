"""Who may talk to the page: browsers on this machine that came with the key, and no script of another site.

The server listens on the loopback address only. On top of that every request must

* name this machine in `Host`: a foreign name that leads to 127.0.0.1 (DNS rebinding) is refused;
* come from the page itself where it has an `Origin`, as all that a script of another site sends has;
* carry the key, which `hydro-env lab` prints as part of the address and the browser then keeps in a cookie that no script
  reads and no other site's script can have sent. So other users of this machine are kept out as well.

No other site can show the page in a frame, and the page loads nothing from elsewhere.
"""

import hmac
from typing import Any

from fastapi.responses import PlainTextResponse, RedirectResponse
from starlette.requests import HTTPConnection

HOSTS = ("127.0.0.1", "localhost", "[::1]")
#: Sent with every answer.
HEADERS = {
    "content-security-policy": "default-src 'self' data: blob: 'unsafe-inline' 'unsafe-eval';"
    " frame-ancestors 'none'; form-action 'self'; base-uri 'self'",
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
}


class Guard:
    """An ASGI application that lets through to another one what the module's text allows; the rest gets 403 and a line."""

    def __init__(self, app: Any, port: int, key: str) -> None:
        self.app = app
        self._key, self._cookie = key, f"hydro_env_lab_{port}"
        self._hosts = {f"{host}:{port}" for host in HOSTS} | ({*HOSTS} if port == 80 else set())

    async def __call__(self, scope: dict[str, Any], receive: Any, send: Any) -> None:
        """Serves a request or a connection."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return

        async def with_headers(message: dict[str, Any]) -> None:
            if message["type"] == "http.response.start":
                more = [(name.encode(), value.encode()) for name, value in HEADERS.items()]
                message = {**message, "headers": [*message.get("headers", []), *more]}
            await send(message)

        asked = HTTPConnection(scope)
        brought = self._matches(asked.query_params.get("key", ""))
        answer: Any
        if reason := self._refusal(asked, brought):
            if scope["type"] == "websocket":
                await send({"type": "websocket.close", "code": 4403, "reason": reason})
                return
            answer = PlainTextResponse(f"hydro-env lab: {reason}\n", 403)
        elif brought and scope["type"] == "http":
            # On to the address without the key, so that it stays out of the browser's history.
            answer = RedirectResponse("/", 303)
            answer.set_cookie(self._cookie, self._key, httponly=True, samesite="lax")
        else:
            answer = self.app
        await answer(scope, receive, with_headers)

    def _refusal(self, asked: HTTPConnection, brought: bool) -> str:
        """Why a request is refused, "" if it is not."""
        host = asked.headers.get("host", "")
        if host not in self._hosts:
            return "this page is served to this machine only"
        if asked.headers.get("origin", f"http://{host}") != f"http://{host}":
            return "a page of another site asked for this"
        if not brought and not self._matches(asked.cookies.get(self._cookie, "")):
            return "open the address that `hydro-env lab` printed; it holds the key"
        return ""

    def _matches(self, key: str) -> bool:
        return hmac.compare_digest(key.encode(), self._key.encode())
