"""The loops around the sweeps of a kernel: blocks, rows of commands, and steps.

Compiled once and shared by all kernels. What a kernel is comes as numbers: rows of its memory, and the addresses of its
sweeps (see `codegen`).
"""

from functools import partial
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from hydro_env.jit import compiled

from .vector_ir import FOUND

#: Sweeps of a module, called by their addresses.
SWEEPS = ("precompute", "observe", "start_row", "evaluate", "attempt_step", "pass_point", "reset_diverged")
#: Names of the numbers of a kernel, in order: rigs to a block, how many rows change and how many stay between calls, rows by name
#: (`delay`, `coupled`: -1 without), addresses.
NUMBERS = (
    "half", "moving", "kept", "command", "load", "applied", "todo", "row_left", "fresh", "delay", "coupled", "points_left",
    "point_speed", "point_passed", "peak_difference", *SWEEPS,
)  # fmt: skip

HALF, MOVING, KEPT, COMMAND, LOAD, APPLIED, TODO, ROW_LEFT, FRESH, DELAY, COUPLED = range(11)
POINTS_LEFT, POINT_SPEED, POINT_PASSED, PEAK = range(11, 15)
PRECOMPUTE, OBSERVE, START_ROW, EVALUATE, ATTEMPT_STEP, PASS_POINT, RESET_DIVERGED = range(15, 22)
#: Attempts at steps for a row of commands, at most, and for each second that it lasts.
MAX_ATTEMPTS, MAX_ATTEMPTS_PER_S = 20_000, 2_000_000.0


@intrinsic  # type: ignore[untyped-decorator]
def sweep(typing: Any, address: Any, cells: Any, h: Any) -> Any:
    """Calls the sweep at an address on the cells of a block; how many lanes passed its test."""

    def emit(context: Any, builder: ir.IRBuilder, signature: Any, arguments: Any) -> ir.Value:
        item = signature.args[1].dtype
        array = context.make_array(signature.args[1])(context, builder, arguments[1])
        kind = context.get_value_type(item)
        kind_of_sweep = ir.FunctionType(FOUND, [kind.as_pointer(), kind])
        called = builder.inttoptr(arguments[0], kind_of_sweep.as_pointer())
        step = context.cast(builder, arguments[2], signature.args[2], item)
        return builder.call(called, [array.data, step])

    return types.int32(address, cells, h), emit


@intrinsic  # type: ignore[untyped-decorator]
def copy(typing: Any, to: Any, place: Any, source: Any, first: Any, count: Any) -> Any:
    """Copies `count` items from source[first:] to to[place:]; compiles in a tenth of the time of a loop."""

    def emit(context: Any, builder: ir.IRBuilder, signature: Any, arguments: Any) -> ir.Value:
        pointers = []
        for array, at in ((0, 1), (2, 3)):
            data = context.make_array(signature.args[array])(context, builder, arguments[array]).data
            pointers.append(builder.gep(data, [arguments[at]]))
        cgutils.raw_memcpy(builder, *pointers, arguments[4], context.get_abi_sizeof(pointers[0].type.pointee))
        return context.get_dummy_value()

    return types.none(to, types.intp, source, types.intp, types.intp), emit


# Threads may step plants of their own side by side.
_nogil = partial(compiled, nogil=True)


@_nogil
def delay(at, cells, ring, lasted, head, period):  # type: ignore[no-untyped-def]
    """Where the time of a lane has come, the command of that time goes to the valve, until the next other one's time comes.

    ring (slots, lanes): the commands of the rows up to this one, in slot `head`, and their durations, s (slots,). Times count
    from the beginning of this row, and equal commands are one: so what went before a reset changes no bit.
    """
    lanes, slots = 2 * at[HALF], ring.shape[0]
    todo, row_left, fresh = at[TODO] * lanes, at[ROW_LEFT] * lanes, at[FRESH] * lanes
    coupled = at[COUPLED] * lanes
    more = False
    for lane in range(lanes):
        left = cells[row_left + lane]
        if cells[todo + lane] <= 0.0 and left > 0.0:
            now, wait = period - left, cells[at[DELAY] * lanes + lane]
            slot, begun, until, back = head, 0.0, period, 0
            while back < slots - 1 and begun + wait > now + 1e-6 * period:
                before = slot - 1 if slot > 0 else slots - 1
                if ring[before, lane] != ring[slot, lane]:
                    until = begun + wait
                slot, begun, back = before, begun - lasted[before], back + 1
            cells[at[APPLIED] * lanes + lane] = ring[slot, lane]
            cells[todo + lane] = left if until >= (1.0 - 1e-6) * period else until - now
            cells[fresh + lane] = 1.0
            more = True
    for lane in range(lanes if more else 0):
        other = lane + at[HALF] if lane < at[HALF] else lane - at[HALF]
        tied = coupled >= 0 and cells[coupled + lane] + cells[coupled + other] > 0.0
        if tied and cells[todo + other] < cells[todo + lane]:
            cells[todo + lane] = cells[todo + other]  # both channels of a rig go equally far
        if cells[fresh + lane] > 0.0:
            cells[row_left + lane] -= cells[todo + lane]
    return more


@_nogil
def follow(at, cells, ring, lasted, b, slot, period, peak, grid):  # type: ignore[no-untyped-def]
    """Steps to the end of a row. Each lane goes at its own pace and waits for the others there.

    ring, lasted and slot as for `advance`, of block b; peak (rigs of a block,): raised to the largest speed difference at the
    points of the grid, rad/s; grid (points + 1, lanes): a row for lanes that pass no point, then speeds, the last first.
    """
    points, lanes = grid.shape[0] - 1, grid.shape[1]
    for lane in range(lanes):
        cells[at[POINTS_LEFT] * lanes + lane] = points - 1
    for _ in range(MAX_ATTEMPTS + int(MAX_ATTEMPTS_PER_S * period)):
        going = sweep(at[ATTEMPT_STEP], cells, period)
        while points > 0 and sweep(at[PASS_POINT], cells, period / points) > 0:
            for lane in range(lanes):
                point = int(cells[at[POINT_PASSED] * lanes + lane])
                grid[point, lane] = cells[at[POINT_SPEED] * lanes + lane]
        if ring is not None and at[DELAY] >= 0 and delay(at, cells, ring[b], lasted[b], slot, period):
            going = lanes
            sweep(at[EVALUATE], cells, period)
        if going == 0:
            break
    for n in range(1, points + 1):
        for rig in range(peak.size):
            apart = abs(grid[n, rig] - grid[n, rig + peak.size])
            peak[rig] = apart if apart > peak[rig] else peak[rig]


@_nogil
def advance(  # type: ignore[no-untyped-def]
    at, memory, cells, ring, lasted, head, commands, loads, period, tolerance, record, every, out, points
):
    """Runs every block through all rows of `commands`, which are held for `period` s each.

    at: the kernel's `NUMBERS`; memory (blocks * kept * lanes,); cells (rows * lanes,), aligned: room to work in; ring (blocks,
    slots, lanes), lasted (blocks, slots) and head: the delay line, how long its rows lasted, s, and the slot of the last one;
    ring is None where there is none, so that nothing of it is compiled. commands, loads (T, rigs or 1, 2): one row for all rigs
    where the middle is 1; tolerance: of the speed, rad/s; record: rows of the memory that go to out (len(record), T // every,
    rigs, 2) at the instant of each row, before its command acts. The largest speed difference at `points` equal parts of each
    row goes to `peak_difference`, rad/s; none where it is 0.
    """
    half, rigs = at[HALF], out.shape[2]
    lanes, kept = 2 * half, 2 * half * at[KEPT]
    delayed = ring is not None and at[DELAY] >= 0
    grid, peak = np.empty((points + 1, lanes), cells.dtype), np.empty(half, cells.dtype)
    for b in range(memory.size // kept):
        start, low = b * kept, b * half
        high = low + half if low + half < rigs else rigs
        slot = head
        copy(cells, 0, memory, start, kept)
        peak[:] = 0.0
        sweep(at[PRECOMPUTE], cells, tolerance)
        for t in range(commands.shape[0]):
            if record.size > 0 and t % every == 0:
                sweep(at[OBSERVE], cells, period)
                for r in range(record.size):
                    first, seen = record[r] * lanes - low, out[r, t // every]
                    for rig in range(low, high):
                        seen[rig, 0], seen[rig, 1] = cells[first + rig], cells[first + half + rig]
            for channel in range(2):
                first = channel * half
                for lane in range(half):
                    rig = low + lane if low + lane < rigs else rigs - 1
                    sent, loaded = min(rig, commands.shape[1] - 1), min(rig, loads.shape[1] - 1)
                    cells[at[COMMAND] * lanes + first + lane] = commands[t, sent, channel]
                    load = loads[min(t, loads.shape[0] - 1), loaded, channel]
                    cells[at[LOAD] * lanes + first + lane] = load
            fresh = sweep(at[START_ROW], cells, period)
            if ring is not None and delayed:
                slot = (slot + 1) % ring.shape[1]
                lasted[b, slot] = period
                for lane in range(lanes):
                    ring[b, slot, lane] = cells[at[COMMAND] * lanes + lane]
                    cells[at[ROW_LEFT] * lanes + lane] = period
                    cells[at[TODO] * lanes + lane] = 0.0
                delay(at, cells, ring[b], lasted[b], slot, period)
            if fresh > 0 or delayed:
                sweep(at[EVALUATE], cells, period)
            follow(at, cells, ring, lasted, b, slot, period, peak, grid)
            sweep(at[RESET_DIVERGED], cells, period)
        for lane in range(half if points > 0 else 0):
            cells[at[PEAK] * lanes + lane] = cells[at[PEAK] * lanes + half + lane] = peak[lane]
        sweep(at[OBSERVE], cells, period)
        copy(memory, start, cells, 0, at[MOVING] * lanes)
