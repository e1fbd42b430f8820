"""The loops around the sweeps of a kernel: blocks, rows of commands, and steps.

Compiled once and shared by all kernels. What a kernel is comes as numbers: rows of its memory, and the addresses of its
sweeps (see `template`).
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from hydro_env.jit import compiled

from .vector_ir import FOUND

__all__ = ["NUMBERS", "SWEEPS", "advance"]

#: Sweeps of `template`, called by their addresses.
SWEEPS = ("look", "guard", "refine", "limit", "ask", "pace", "begin", "finish")
#: Names of the numbers of a kernel, in order: rigs to a block, how many rows change and how many stay between calls, the most
#: parts of a substep, rows by name (`late`: -1 without a delay line), addresses.
NUMBERS = (
    "half",
    "moving",
    "kept",
    "most_parts",
    "command",
    "load",
    "applied",
    "todo",
    "left",
    "late",
    *SWEEPS,
)

HALF, MOVING, KEPT, MOST_PARTS, COMMAND, LOAD, APPLIED, TODO, LEFT, LATE = range(10)
LOOK, GUARD, REFINE, LIMIT, ASK, PACE, BEGIN, FINISH = range(10, 18)


@intrinsic  # type: ignore[untyped-decorator]
def sweep(typing: Any, address: Any, cells: Any, h: Any) -> Any:
    """Calls the sweep at an address on the cells of a block; whether it found a lane that passes its test."""

    def emit(context: Any, builder: ir.IRBuilder, signature: Any, arguments: Any) -> ir.Value:
        item = signature.args[1].dtype
        array = context.make_array(signature.args[1])(context, builder, arguments[1])
        kind = context.get_value_type(item)
        kind_of_sweep = ir.FunctionType(FOUND, [kind.as_pointer(), kind])
        called = builder.inttoptr(arguments[0], kind_of_sweep.as_pointer())
        step = context.cast(builder, arguments[2], signature.args[2], item)
        return builder.icmp_signed("!=", builder.call(called, [array.data, step]), FOUND(0))

    return types.boolean(address, cells, h), emit


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


def _nogil(function: Any) -> Any:
    return compiled(
        function, nogil=True, allocates=False
    )  # threads may step plants of their own side by side


@_nogil
def delay(at, cells, ring, end, substep):  # type: ignore[no-untyped-def]
    """Where a substep (s) begins, the command goes to a slot of the ring (slots, lanes) and one from as many slots before as it
    is late, with a fraction, to the valve. `end`: the slot after the last one of this row."""
    lanes, slots = 2 * at[HALF], ring.shape[0]
    end %= slots
    todo_row, left_row, late_row = at[TODO] * lanes, at[LEFT] * lanes, at[LATE] * lanes
    command_row, applied_row = at[COMMAND] * lanes, at[APPLIED] * lanes
    for lane in range(lanes):
        todo = int(cells[todo_row + lane])
        if todo > 0 and cells[left_row + lane] <= 0.0:
            slot = end - todo  # a division for each lane would take as long as all the rest
            slot = slot if slot >= 0 else slot % slots
            ring[slot, lane] = cells[command_row + lane]
            late = min(cells[late_row + lane] / substep, slots - 2.0)
            whole = int(late)
            share = late - whole
            newer = slot - whole if slot >= whole else slot - whole + slots
            older = newer - 1 if newer > 0 else slots - 1
            cells[applied_row + lane] = (1.0 - share) * ring[newer, lane] + share * ring[older, lane]


@_nogil
def advance(  # type: ignore[no-untyped-def]
    at, memory, cells, ring, head, commands, loads, substeps, h, looked_at, record, every, out
):
    """Runs every block through all rows of `commands`, `substeps` steps of `h` seconds to a row.

    `looked_at` is the step in s by which channels are called stiff, `h` or 0: then none is.

    at: the kernel's `NUMBERS`; memory (blocks * kept * lanes,); cells (rows * lanes,), aligned: room to work in; ring (blocks,
    slots, lanes) and head: the delay line, None where there is none, so that nothing of it is compiled; commands, loads (T, rigs
    or 1, 2): one row for all rigs where the middle is 1; record: rows of the memory that go to out (len(record), T // every,
    rigs, 2) at the instant of each row, before its command acts.
    """
    half = at[HALF]
    lanes = 2 * half
    kept = at[KEPT] * lanes
    whole_step = cells.dtype.type(h)
    rigs = out.shape[2]
    for b in range(memory.size // kept):
        start, low = b * kept, b * half
        high = low + half if low + half < rigs else rigs
        copy(cells, 0, memory, start, kept)
        sweep(at[REFINE], cells, looked_at)
        for t in range(commands.shape[0]):
            if record.size > 0 and t % every == 0:
                sweep(at[LOOK], cells, whole_step)
                for r in range(record.size):
                    first, seen = record[r] * lanes - low, out[r, t // every]
                    for rig in range(low, high):
                        seen[rig, 0], seen[rig, 1] = cells[first + rig], cells[first + half + rig]
            for channel in range(2):
                first = channel * half
                for lane in range(half):
                    rig = low + lane if low + lane < rigs else rigs - 1
                    cells[at[COMMAND] * lanes + first + lane] = commands[
                        t, rig if rig < commands.shape[1] else 0, channel
                    ]
                    cells[at[LOAD] * lanes + first + lane] = loads[
                        t if t < loads.shape[0] else 0, rig if rig < loads.shape[1] else 0, channel
                    ]
            sweep(at[LIMIT], cells, substeps)
            # Each lane goes through its substeps at its own pace, whole or in parts; it waits for the others at the next row.
            sweep(at[ASK], cells, whole_step)
            for _ in range(at[MOST_PARTS] * substeps):
                if ring is not None and at[LATE] >= 0:
                    delay(at, cells, ring[b], head + (t + 1) * substeps, whole_step)
                sweep(at[PACE], cells, whole_step)
                sweep(at[BEGIN], cells, whole_step)
                if not sweep(at[FINISH], cells, whole_step):
                    break
            sweep(at[GUARD], cells, whole_step)
        sweep(at[LOOK], cells, whole_step)
        copy(memory, start, cells, 0, at[MOVING] * lanes)
