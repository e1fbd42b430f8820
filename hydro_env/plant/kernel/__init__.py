"""The compiled step: the right-hand side and chosen effects as vectorised machine code.

integrator  the tableau, the estimate of the error and the control of the step, with their references
layout      where states, parameters and stages lie in the memory of a block
laws        sources of laws and of the functions that they call: checks, and text
statements  from the right-hand side and the laws of the effects to statements
codegen     writes the text of a module: sweeps over lanes
vector_ir   writes it, read by `hydro_env.ir`, as vector instructions
machine_code  compiles them and keeps what was compiled
driver      the loops over rows and steps around the sweeps, one for all kernels

Method: three stages of ROS3w and steps by measured error (see `integrator`), with a matrix W that holds the stiff loops of a
channel (coil, spool, bristle; pressure, speed) as the effects shape them, how the states of effects decay, what drives them, and
what they do to leakage and force. It leaves out what else they act on, the angle, and the steepest fall of the spool's friction.

Layout: the loop over steps is outside and the loops over lanes inside. Nothing is fused or reordered by the compiler: the reader
fuses products and sums statement by statement, and a lane's steps depend on that lane (or its coupled pair) alone, so every lane
gets the same bits whatever its neighbours, its place, the width of the block and the neutral effects that are compiled in.

Source text: `rates` (rhs.py), the laws of the effects and the functions of vector_math are pasted into one generated
module, compiled once for a set of effects and a width of blocks. The loops around the sweeps are compiled once for all.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache, partial
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..catalogue import CATALOGUE, Effect
from .codegen import module_text
from .driver import SWEEPS, advance
from .layout import STATES
from .machine_code import MachineCode, machine_code

__all__ = ["STATES", "Kernel", "compile_kernel"]


@dataclass(frozen=True)
class Kernel:
    """A compiled step for a set of effects.

    `advance(memory, cells, ring, lasted, head, commands, loads, period, tolerance, record, every, out)` runs every block
    through all rows of `commands`, see `driver.advance`. `rows` maps names of states, parameters and outputs to rows of the
    memory. `has_delay`: commands go through a delay line. `numbers` are the driver's, addresses aside.
    """

    effects: tuple[str, ...]
    half: int
    rows: dict[str, int]
    num_rows: int
    dtype: np.dtype[Any]
    num_cells: int
    has_delay: bool
    advance: Callable[..., None]
    source: str
    numbers: dict[str, int]
    machine_code: MachineCode
    grouped: bool = False

    def __reduce__(self) -> tuple[Any, ...]:
        """A copy, and what another process unpickles, is compiled there, or already is."""
        return compile_kernel, (self.effects, self.half, self.dtype, self.grouped)

    def room(self) -> NDArray[Any]:
        """Room for a block to be worked on (`cells`), from a cache line's beginning."""
        item = self.dtype.itemsize
        cells = np.zeros(self.num_cells + 64 // item, self.dtype)
        return cells[-cells.ctypes.data % 64 // item :][: self.num_cells]


#: The compiler of syntax trees is not safe in several threads at once (seen with Python 3.11).
_COMPILING = Lock()


@lru_cache(maxsize=64)
def _compiled(effects: tuple[Effect, ...], half: int, single: bool, grouped: bool) -> Kernel:
    with _COMPILING:
        module = module_text(effects, half, grouped)
        code = machine_code(module.text, single)
    numbers = module.numbers | dict(zip(SWEEPS, code.addresses, strict=True))
    return Kernel(
        effects=tuple(e.name for e in effects), half=half, rows=module.rows, num_rows=module.numbers["kept"],
        dtype=np.dtype(np.float32 if single else np.float64), num_cells=module.num_rows * 2 * half,
        has_delay=any(e.delays_command for e in effects),
        advance=partial(advance, np.array(list(numbers.values()), np.int64)), source=module.text,
        numbers=module.numbers, machine_code=code, grouped=grouped,
    )  # fmt: skip


def compile_kernel(
    effects: Iterable[str] = (), half: int = 8, dtype: Any = np.float64, grouped: bool = False
) -> Kernel:
    """The kernel for these effects. KeyError for an effect the catalogue lacks.

    `dtype` is float64, or float32 for twice the lanes to a vector. `grouped`: all rigs of a block take the steps of its first.

    The effects act in the order of the catalogue, whatever order they are named in.
    """
    wanted = set(effects)
    for name in wanted:
        CATALOGUE[name]
    single = np.dtype(dtype) == np.float32
    return _compiled(tuple(e for e in CATALOGUE.values() if e.name in wanted), half, single, grouped)
