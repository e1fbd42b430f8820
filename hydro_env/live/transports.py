"""How samples come and commands go: OPC UA (needs the extra `live`) and UDP.

Whatever ends a connection is an OSError, whatever is wrong with a name of the link file an InputError.
"""

import asyncio
import logging
import socket
from collections.abc import Coroutine, Mapping
from contextlib import suppress
from typing import Any, TypeVar

from hydro_env.errors import InputError
from hydro_env.files import to_json
from hydro_env.live.link import Link, host_and_port
from hydro_env.reading import parse_json

T = TypeVar("T")

#: Samples that may wait; older ones are dropped.
WAITING = 4
#: Share of a cycle in which a new sample is looked for.
LOOK = 0.2


class Udp(asyncio.DatagramProtocol):
    """Datagrams that hold a JSON object each. Those of other hosts than the rig's are ignored."""

    def __init__(self, link: Link) -> None:
        self._rig, self._here = host_and_port("address", link.address), host_and_port("listen", link.listen)
        self._cycle = link.cycle_s
        self._came: asyncio.Queue[bytes] = asyncio.Queue(WAITING)
        self._socket: asyncio.DatagramTransport | None = None

    async def open(self, patience: float) -> None:
        """Connects within a time in s."""
        loop = asyncio.get_running_loop()
        try:
            found = await loop.getaddrinfo(*self._rig, family=socket.AF_INET, type=socket.SOCK_DGRAM)
        except OSError as problem:
            raise OSError(problem.errno, f"{self._rig[0]} is not known here ({problem.strerror})") from None
        self._to = found[0][4]
        self._socket, _ = await loop.create_datagram_endpoint(lambda: self, local_addr=self._here)

    def datagram_received(self, data: bytes, addr: Any) -> None:
        """Keeps a datagram of the rig."""
        if addr[0] == self._to[0]:
            if self._came.full():
                self._came.get_nowait()
            self._came.put_nowait(data)

    async def receive(self, timeout: float) -> Mapping[str, Any] | None:
        """What the rig shows next, by the names of the link file; None if nothing came in time, s, or sooner. InputError for what
        cannot be read."""
        try:
            # A command is sent again while a sample is late.
            data = await asyncio.wait_for(self._came.get(), min(timeout, 1.5 * self._cycle))
        except TimeoutError:
            return None
        found = parse_json(data.decode("utf-8", "replace"), "datagram")
        if not isinstance(found, dict):
            raise InputError("datagram: should be a JSON object")
        return found

    async def send(self, numbers: Mapping[str, float], timeout: float) -> None:
        """Writes numbers by the names of the link file; OSError where that takes longer (s)."""
        if self._socket is not None:
            self._socket.sendto(to_json(numbers).encode(), self._to)

    async def close(self) -> None:
        """Ends the connection."""
        if self._socket is not None:
            self._socket.close()


class OpcUa:
    """All nodes are read, and all written, by one service call a cycle. The methods are those of `Udp`.

    ModuleNotFoundError without asyncua.
    """

    def __init__(self, link: Link) -> None:
        import asyncua

        logging.getLogger("asyncua").setLevel(logging.CRITICAL)  # whatever happens is told here
        self._asyncua, self._ua, self._link = asyncua, asyncua.ua, link
        self._client: Any = None
        self._next, self._count = 0.0, None
        self._reading: asyncio.Task[Mapping[str, Any]] | None = None

    async def open(self, patience: float) -> None:
        link, ua = self._link, self._ua
        self._client = self._asyncua.Client(link.address, timeout=max(1.0, link.watchdog_s))
        with _connection():
            await _within(self._client.connect(), patience)
            outputs = [*(each.name for each in link.commands), *filter(None, [link.heartbeat])]
            nodes = {}
            for name in [*link.names, *outputs]:
                try:
                    nodes[name] = self._client.get_node(name)
                    await nodes[name].read_value()
                except (ua.UaStatusCodeError, ua.UaStringParsingError) as problem:
                    raise InputError(f"{link.address} has no node {name!r}: {problem}") from None
            self._inputs = {name: nodes[name] for name in link.names}
            self._outputs = {
                name: (nodes[name], await nodes[name].read_data_type_as_variant_type()) for name in outputs
            }

    async def receive(self, timeout: float) -> Mapping[str, Any] | None:
        if self._reading is None:
            self._reading = _begun(self._new())
        await asyncio.wait({self._reading}, timeout=timeout)
        if not self._reading.done():
            return None  # goes on
        done, self._reading = self._reading, None
        return done.result()

    async def _new(self) -> Mapping[str, Any]:
        """Reads in step with the server: a little before the next sample is due, and then until its count has risen."""
        clock, cycle, count = asyncio.get_running_loop().time, self._link.cycle_s, self._link.count
        while True:
            await asyncio.sleep(max(0.0, self._next - clock()))
            with _connection():
                values = await self._client.read_attributes(self._inputs.values())
            found = {
                name: each.Value.Value if each.StatusCode.is_good() and each.Value is not None else None
                for name, each in zip(self._inputs, values, strict=True)
            }
            now = clock()
            if not count:
                self._next = max(self._next + cycle, now)
                return found
            if found[count] != self._count:
                self._next, self._count = now + (1.0 - LOOK) * cycle, found[count]
                return found
            self._next = now + 0.5 * LOOK * cycle

    async def send(self, numbers: Mapping[str, float], timeout: float) -> None:
        ua, values = self._ua, []
        for name, number in numbers.items():
            kind = self._outputs[name][1]
            whole = kind not in (ua.VariantType.Float, ua.VariantType.Double)
            values.append(ua.DataValue(ua.Variant(round(number) if whole else float(number), kind)))
        nodes = [self._outputs[name][0] for name in numbers]
        with _connection():
            await _within(self._client.write_values(nodes, values), timeout)

    async def close(self) -> None:
        self._reading = None
        if self._client is not None:
            with suppress(Exception):
                await _within(self._client.disconnect(), 1.0)


Transport = Udp | OpcUa


def _begun(work: Coroutine[Any, Any, T]) -> asyncio.Task[T]:
    """A task whose failure may stay unseen."""
    task = asyncio.create_task(work)
    task.add_done_callback(lambda done: done.cancelled() or done.exception())
    return task


async def _within(work: Coroutine[Any, Any, T], timeout: float) -> T:
    """The result of work, or a TimeoutError. Work that is late is left alone: asyncua's requests are not safe to cancel."""
    task = _begun(work)
    await asyncio.wait({task}, timeout=timeout)
    if not task.done():
        raise TimeoutError(f"no answer within {timeout:g} s")
    return task.result()


class _connection:
    """Turns what asyncua raises where a connection or a call fails into an OSError; a timeout is one."""

    def __enter__(self) -> None: ...

    def __exit__(self, kind: Any, problem: BaseException | None, trace: Any) -> None:
        if isinstance(problem, Exception) and not isinstance(problem, OSError | InputError):
            raise OSError(f"{type(problem).__name__}: {problem}".rstrip(": ")) from problem
