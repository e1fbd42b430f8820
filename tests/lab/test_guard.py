"""Who may talk to the page: this machine with the key, and no other site."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from hydro_env.lab.guard import Guard

PORT, KEY = 8137, "a-key"
HOST = f"127.0.0.1:{PORT}"
COOKIE = f"hydro_env_lab_{PORT}={KEY}"


async def served(scope: dict[str, Any], receive: Any, send: Any) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.accept"})
        return
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"inside"})


def answer(kind: str = "http", query: str = "", **headers: str) -> tuple[dict[str, Any], bytes]:
    sent: list[dict[str, Any]] = []

    async def send(message: dict[str, Any]) -> None:
        sent.append(message)

    listed = [(name.encode(), value.encode()) for name, value in headers.items()]
    scope = {"type": kind, "path": "/", "query_string": query.encode(), "headers": listed}
    asyncio.run(Guard(served, PORT, KEY)(scope, None, send))
    return sent[0], b"".join(message.get("body", b"") for message in sent)


def headers_of(message: dict[str, Any]) -> dict[str, str]:
    return {name.decode(): value.decode() for name, value in message["headers"]}


@pytest.mark.parametrize("host", [HOST, f"localhost:{PORT}", f"[::1]:{PORT}"])
def test_the_key_opens_the_page_and_then_the_cookie_does(host: str) -> None:
    first, body = answer(query=f"key={KEY}", host=host)
    given = headers_of(first)
    assert first["status"] == 303 and given["location"] == "/" and b"inside" not in body
    assert (
        COOKIE in given["set-cookie"]
        and "HttpOnly" in given["set-cookie"]
        and "SameSite" in given["set-cookie"]
    )
    second, body = answer(host=host, cookie=given["set-cookie"].partition(";")[0])
    assert second["status"] == 200 and body == b"inside"
    assert "frame-ancestors 'none'" in headers_of(second)["content-security-policy"]
    assert (
        answer("websocket", host=host, cookie=COOKIE, origin=f"http://{host}")[0]["type"]
        == "websocket.accept"
    )


@pytest.mark.parametrize("kind", ["http", "websocket"])
@pytest.mark.parametrize(
    ("headers", "word"),
    [
        ({"host": f"evil.example:{PORT}", "cookie": COOKIE}, "this machine"),
        ({"host": "127.0.0.1:80", "cookie": COOKIE}, "this machine"),
        ({"cookie": COOKIE}, "this machine"),
        ({"host": HOST, "cookie": COOKIE, "origin": "https://evil.example"}, "another site"),
        ({"host": HOST, "cookie": COOKIE, "origin": "null"}, "another site"),
        ({"host": HOST, "cookie": COOKIE, "origin": "http://127.0.0.1:9999"}, "another site"),
        ({"host": HOST}, "holds the key"),
        ({"host": HOST, "cookie": f"hydro_env_lab_{PORT}=other"}, "holds the key"),
        ({"host": HOST, "cookie": "hydro_env_lab_9999=" + KEY}, "holds the key"),
    ],
)
def test_all_others_are_refused_with_a_line(kind: str, headers: dict[str, str], word: str) -> None:
    message, body = answer(kind, **headers)
    if kind == "websocket":
        assert message["type"] == "websocket.close" and word in message["reason"]
    else:
        assert message["status"] == 403 and word in body.decode() and b"inside" not in body


def test_a_wrong_key_is_refused_even_if_it_is_no_ascii() -> None:
    assert answer(query="key=%C3%BC", host=HOST)[0]["status"] == 403
    assert answer(query=f"key={KEY}x", host=HOST)[0]["status"] == 403
