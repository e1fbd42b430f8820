"""A simulated rig behind UDP or a real OPC UA server on loopback, in real time, with faults on demand.

Its own controller does what docs/howto/safety.md asks of a PLC: without a new heartbeat for `OWN_WATCHDOG` it closes the valves.
"""

from __future__ import annotations

import asyncio
import json
import math
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from hydro_env.live.link import Link
from hydro_env.plant import Plant
from hydro_env.units import BAR, RPM

WATCHDOG, OWN_WATCHDOG = 0.5, 0.5
#: Speed of channel 1 and command of channel 2 are mounted the other way round.
SIGNS = (-1, 1), (1, -1)
RATED = (10.0, 10.0)
Numbers = dict[str, Any]


def free_port(kind: int = socket.SOCK_DGRAM) -> int:
    with socket.socket(socket.AF_INET, kind) as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


class Rig(threading.Thread):
    """The plant in real time. `applied`: time, commands (2,) as shares at the valves, written down at every cycle.

    `disturb(numbers)` may change what is sent, or return None for nothing; `broken` is when it first did.
    """

    prefix = ""
    cycle = 0.02

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.plant = Plant("paper_dead_zone")
        self.received: Numbers = {}
        self.received_at = -math.inf
        self.rest()
        self.over, self.ready = threading.Event(), threading.Event()
        self._noise = np.random.default_rng(0)
        self._count = 0

    def rest(self) -> None:
        """Motors at rest, sensors in order, nothing written down."""
        self.plant.reset()
        self.disturb: Callable[[Numbers], Numbers | None] = lambda numbers: numbers
        self.applied: list[tuple[float, float, float]] = []

    def link(self, **changed: Any) -> Link:
        names = {
            key: f"{self.prefix}{key}"
            for key in ("n", "t", "alive", "n1", "n2", "p1", "p2", "i1", "i2", "u1", "u2")
        }
        table: dict[str, Any] = {
            "cycle_s": self.cycle, "watchdog_s": WATCHDOG, "rate_limit": 20.0, "count": names["n"],
            "time": {"name": names["t"], "unit": "ms"}, "heartbeat": names["alive"],
        }  # fmt: skip
        for c in (1, 2):
            table[f"channel_{c}"] = {
                "command": {"name": names[f"u{c}"], "rated": RATED[c - 1], "sign": SIGNS[1][c - 1]},
                "speed": {
                    "name": names[f"n{c}"],
                    "unit": "rpm",
                    "sign": SIGNS[0][c - 1],
                    "range": [-900, 900],
                },
                "pressure": {"name": names[f"p{c}"], "unit": "bar"},
                "current": {"name": names[f"i{c}"], "unit": "A"},
            }
        return Link.model_validate(table | self.address() | changed)

    def address(self) -> Numbers:
        raise NotImplementedError

    def numbers(self) -> Numbers:
        """What its sensors show."""
        self._count += 1
        e = self._noise.standard_normal((3, 2))
        found: Numbers = {"n": self._count, "t": round(self._count * self.cycle * 1e3)}
        speed, current, pressure = (
            self.plant.get(name)[0] for name in ("measured_speed", "current", "pressure")
        )
        for c in (0, 1):
            found[f"n{c + 1}"] = SIGNS[0][c] * round(speed[c] / RPM + e[0, c], 1)
            found[f"p{c + 1}"] = round(pressure[c] / BAR + 0.05 * e[1, c], 2)
            found[f"i{c + 1}"] = round(current[c] + 0.002 * e[2, c], 4)
        return found

    def take(self, numbers: Numbers) -> None:
        """Commands that came."""
        if numbers.get("alive") != self.received.get("alive"):
            self.received, self.received_at = numbers, time.monotonic()

    def advance(self) -> None:
        """A cycle under the commands that came last."""
        shares = np.array([SIGNS[1][c] * self.received.get(f"u{c + 1}", 0.0) / RATED[c] for c in (0, 1)])
        if time.monotonic() - self.received_at > OWN_WATCHDOG:
            shares[:] = 0.0
        self.applied.append((time.monotonic(), *map(float, shares)))
        self.plant.hold(shares[None] * self.plant.get("u_rated"), np.zeros((1, 2)), self.cycle)

    def closed_after(self, moment: float) -> float:
        """How long after a moment the valves were closed for good, s."""
        after = [t for t, *shares in self.applied if any(shares)]
        assert after and after[-1] < self.applied[-1][0], "the valves are open"
        return max(0.0, after[-1] - moment)

    def end(self) -> None:
        self.over.set()
        self.join(5.0)


class UdpRig(Rig):
    def __init__(self) -> None:
        super().__init__()
        self._here, self._there = free_port(), free_port()

    def address(self) -> Numbers:
        return {"protocol": "udp", "address": f"127.0.0.1:{self._here}", "listen": f"127.0.0.1:{self._there}"}

    def run(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
            own.bind(("127.0.0.1", self._here))
            self.ready.set()
            tick = time.monotonic()
            while not self.over.is_set():
                numbers = self.disturb(self.numbers())
                if numbers is not None:
                    own.sendto(json.dumps(numbers).encode(), ("127.0.0.1", self._there))
                tick += self.cycle
                while (left := tick - time.monotonic()) > 0.0:
                    own.settimeout(left)
                    try:
                        self.take(json.loads(own.recv(4096)))
                    except (TimeoutError, OSError):
                        break
                time.sleep(max(0.0, tick - time.monotonic()))
                self.advance()


class OpcUaRig(Rig):
    prefix = "ns=2;s=Rig."
    cycle = 0.05

    def __init__(self) -> None:
        super().__init__()
        self._port = free_port(socket.SOCK_STREAM)
        self.alive = True
        """Whether the server runs; the rig goes on without it."""

    def address(self) -> Numbers:
        return {"protocol": "opcua", "address": f"opc.tcp://127.0.0.1:{self._port}"}

    def run(self) -> None:
        asyncio.run(self._serve())

    async def _opened(self) -> tuple[Any, dict[str, Any]]:
        from asyncua import Server, ua

        server = Server()
        await server.init()
        server.set_endpoint(f"opc.tcp://127.0.0.1:{self._port}")
        await server.register_namespace("http://example.org/rig")
        nodes = {}
        for name, value in (self.numbers() | {"u1": 0.0, "u2": 0.0, "alive": 0}).items():
            kind = ua.VariantType.Int32 if name in ("n", "t", "alive") else ua.VariantType.Float
            node = await server.nodes.objects.add_variable(ua.NodeId(f"Rig.{name}", 2), name, value, kind)
            await node.set_writable()
            nodes[name] = (node, kind)
        await server.start()
        return server, nodes

    async def _serve(self) -> None:
        from asyncua import ua

        server, nodes = await self._opened()
        self.ready.set()
        tick, running = time.monotonic(), True
        while not self.over.is_set():
            if self.alive != running:
                running = self.alive
                await (server.start() if running else stopped(server))
            numbers = self.disturb(self.numbers())
            for name, value in (numbers or {}).items():
                await server.write_attribute_value(
                    nodes[name][0].nodeid, ua.DataValue(ua.Variant(value, nodes[name][1]))
                )
            # The heartbeat first: it is written last.
            self.take({name: await nodes[name][0].read_value() for name in ("alive", "u1", "u2")})
            tick = max(tick + self.cycle, time.monotonic() - self.cycle)
            await asyncio.sleep(max(0.0, tick - time.monotonic()))
            self.advance()
        if running:
            await stopped(server)


async def stopped(server: Any) -> None:
    """A client that comes back while the server closes would hold it open for ever: then its connection is closed, too."""
    while True:
        try:
            return await asyncio.wait_for(server.stop(), 1.0)
        except TimeoutError:
            pass


def late(cycles: int) -> Callable[[Numbers], Numbers | None]:
    """What is sent is `cycles` old from now on."""
    waiting: deque[Numbers] = deque()

    def disturb(numbers: Numbers) -> Numbers | None:
        waiting.append(numbers)
        return waiting.popleft() if len(waiting) > cycles else None

    return disturb
