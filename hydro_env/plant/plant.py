"""The plant as an object: many rigs side by side, stepped together by the compiled kernel.

Arrays have the shape (num_rigs, 2), column 0 is channel 1, column 1 channel 2; everything is SI.
"""

import copy
import os
from collections.abc import Iterable, Mapping, Sequence
from math import ceil, inf
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, DTypeLike

from ..arrays import Bools, Floats, Integers
from ..errors import InputError, check_known
from .catalogue import CATALOGUE
from .catalogue.effect import parameter_of
from .kernel import STATES, Kernel, compile_kernel
from .model import PlantModel
from .model_files import load_model
from .parameters import PARAMETERS

#: Signals that can be read and recorded.
#: `mean_line_pressure` (Pa) is half the sum of both line pressures: half the supply's and what effects add, where the model has a
#: supply pressure, else only what they add. `motor_pressure` (Pa) is the load pressure at the ports of the motor.
SIGNALS = (*STATES, "flow", "measured_speed", "mean_line_pressure", "motor_pressure")

#: Rigs that the kernel can be compiled to take together.
BLOCKS = (1, 2, 4, 8, 16, 32)
#: Longest delay of the command that the delay line holds, s, if the model has no longer one.
USUAL_DELAY = 0.05
#: Delay from which on no command would arrive within any log or episode, s.
MAX_DELAY = 1e5

_NO_RECORD = np.zeros(0, np.int64)

#: Longest part of a period between two points of the grid on which its `peak_difference` is taken, s.
GRID = 1e-3


def grid_points(period: float) -> int:
    """Into how many equal parts of `GRID` at most a period in s is divided."""
    return max(1, ceil(period / GRID * (1.0 - 1e-9)))


class Lost(NamedTuple):
    """A channel (1, 2) of a rig that was put to rest: its time since the reset, s, and the state that could not be followed."""

    rig: int
    channel: int
    time: float
    state: str

    def __str__(self) -> str:
        state = self.state.replace("__", ".")
        return f"the simulation of channel {self.channel} cannot follow {state!r} at {self.time:.4g} s"


def _half(num_rigs: int, dtype: DTypeLike) -> int:
    """Rigs to a block: four vectors of channels for a batch, no idle lanes for one or two rigs. Either gives the same bits."""
    return 1 if num_rigs <= 2 else 128 // np.dtype(dtype).itemsize


def machine_memory() -> float:
    """Memory of this machine in bytes, inf where it does not say."""
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, ValueError, OSError):
        return inf


def _signal(name: str, what: str) -> Any:
    """A property of a plant: a signal of every rig, (num_rigs, 2), as a copy."""
    return property(lambda plant: plant.get(name), doc=what)


class Plant:
    """`num_rigs` rigs of two channels each.

    Row i behaves bit for bit like the same row alone. `effects` names further effects whose parameters may be set by
    row; those of the model are always there. `tolerance` (rad/s, that of the model unless given) is the error of a speed by which
    every channel chooses its steps, see `kernel.integrator`. `dtype` is float64, or float32 for about twice the speed: it
    resolves the angle and the time of an episode to seven digits only. `block` is how many rigs go through the kernel together
    (1, 2, 4, 8, 16 or 32, chosen by their number unless given), a matter of speed alone, unless they are `grouped`: then all rigs
    of a block take the steps of its first, as differences between neighbours need it.

    InputError for an unknown model and for more rigs than this machine has memory for. ValueError for a number of rigs
    below one, a tolerance that is not positive, another dtype or another block.
    """

    def __init__(
        self, model: str | Path | PlantModel = "paper", num_rigs: int = 1, *, effects: Iterable[str] = (),
        tolerance: float | None = None, dtype: DTypeLike = np.float64, block: int | None = None,
        grouped: bool = False,
    ) -> None:  # fmt: skip
        if num_rigs < 1:
            raise ValueError(f"num_rigs is {num_rigs}, expected at least 1")
        if np.dtype(dtype) not in (np.float32, np.float64):
            raise ValueError(f"dtype is {np.dtype(dtype)}, expected float64 or float32")
        if block is not None and block not in BLOCKS:
            raise ValueError(f"block is {block}, expected one of {', '.join(map(str, BLOCKS))}")
        self.model = load_model(model)
        self.num_rigs = int(num_rigs)
        self.tolerance = float(self.model.tolerance if tolerance is None else tolerance)
        if not self.tolerance > 0.0:
            raise ValueError(f"tolerance is {tolerance}, expected more than 0 rad/s")
        effects = tuple(effects)
        check_known("unknown effect", effects, CATALOGUE)
        half = _half(self.num_rigs, dtype) if block is None else block
        #: The compiled step.
        self.kernel: Kernel = compile_kernel((*self.model.declared, *effects), half, dtype, grouped)
        kernel = self.kernel
        #: Effects whose terms are compiled in.
        self.effects = kernel.effects
        #: Names of the states, which come first in the memory.
        self.states = tuple(name for name, row in kernel.rows.items() if row < kernel.rows["time"])
        blocks = -(-self.num_rigs // kernel.half)
        described = [CATALOGUE[name] for name in kernel.effects]
        #: Parameters by which commands are late, and the longest delay that the delay line holds, s.
        self.delays = [f"{e.name}.{e.delays_command}" for e in described if e.delays_command]
        longest = [sum(self.model.value(name, channel) for name in self.delays) for channel in (0, 1)]
        self.longest_delay = max(USUAL_DELAY, *longest)
        if not self.longest_delay <= MAX_DELAY:
            raise InputError(
                f"model {self.model.name!r}: the command is delayed by {self.longest_delay:g} s; at most {MAX_DELAY:g} s"
                " are right"
            )
        self._fits(blocks * 2.0 * kernel.half * kernel.num_rows * kernel.dtype.itemsize)
        #: The memory, (blocks, rows, 2 * half), for compiled readers: nothing to write to. Rig i is lane i % half of block i //
        #: half, its channel 2 lies `half` lanes further; `row_of` numbers the rows.
        self.memory = np.zeros((blocks, kernel.num_rows, 2 * kernel.half), kernel.dtype)
        #: The delay line: commands of rows and how long these lasted, s, and the slot of the last one.
        self._ring, self._lasted = np.zeros((blocks, 1, 2 * kernel.half)), np.full((blocks, 1), inf)
        self._head = 0
        self._empty = np.zeros((0, 1, self.num_rigs, 2))
        names = [*PARAMETERS, *(f"{e.name}.{p.name}" for e in described for p in e.parameters)]
        pairs = np.array([self.model.pair(name) for name in names])
        self._by_channel(self.memory)[:, [self.row_of(name) for name in names]] = pairs[..., None]
        self._cells = kernel.room()
        self._observe()

    def _fits(self, need: float) -> None:
        """InputError where `need` bytes are more than this machine has."""
        if need > (most := machine_memory()):
            raise InputError(
                f"{self.num_rigs} rigs need {need / 2**30:.3g} GiB for their plant alone, this machine has"
                f" {most / 2**30:.3g} GiB, enough for about {int(self.num_rigs * most / need)}"
            )

    def make_room(self, period: float) -> None:
        """Has the delay line hold what is under way in rows of `period` s; shorter rows need more room."""
        blocks, slots, lanes = self._ring.shape
        if not self.kernel.has_delay or slots >= (wanted := int(self.longest_delay / period) + 3):
            return
        self._fits(blocks * 8.0 * wanted * (lanes + 1))
        ring, lasted = np.zeros((blocks, wanted, lanes)), np.full((blocks, wanted), inf)
        order = (self._head + 1 + np.arange(slots)) % slots  # the oldest first
        ring[:, :slots], lasted[:, :slots] = self._ring[:, order], self._lasted[:, order]
        self._ring, self._lasted, self._head = ring, lasted, slots - 1

    # --- rows of the memory ---------------------------------------------------------------------------------------
    def _by_channel(self, cells: Floats) -> Floats:
        """The memory or the delay line, (blocks, rows, 2 * half), with an axis for the channel: (blocks, rows, 2, half)."""
        return cells.reshape(len(cells), -1, 2, self.kernel.half)

    def get(self, name: str) -> Floats:
        """A parameter or signal of every rig, (num_rigs, 2), as a copy. KeyError for a name the plant lacks."""
        row = self._by_channel(self.memory)[:, self.row_of(name)]
        return row.swapaxes(1, 2).reshape(-1, 2)[: self.num_rigs].astype(np.float64)

    def row_of(self, name: str) -> int:
        """Number of the row of `memory` that holds a parameter or signal. KeyError for a name the plant lacks."""
        try:
            return self.kernel.rows[name]
        except KeyError:
            parameter_of(name)  # InputError for a name that nobody knows
            raise KeyError(
                f"{name}: the effect is not among this plant's ({', '.join(self.effects) or 'none'})"
            ) from None

    def set(self, name: str, values: ArrayLike, rows: ArrayLike | None = None) -> None:
        """Sets a parameter ("Kq", "dead_zone.overlap_positive") of all rigs or of `rows` (indices or mask).

        `values` broadcasts to (number of rows, 2). KeyError for a name the plant lacks, ValueError for a delay of the
        command that is longer than the delay line.
        """
        self.set_values({name: values}, rows)

    def set_values(self, values: Mapping[str, ArrayLike], rows: ArrayLike | None = None) -> None:
        """Sets several parameters, which takes hardly longer than one; see `set`."""
        block, lane = self._lanes(rows)
        places, pairs = np.empty((len(values), 1), np.int64), np.empty((len(values), block.size, 2))
        for name, value, place, pair in zip(values, values.values(), places, pairs, strict=True):
            if name not in PARAMETERS and "." not in name:
                parameter_of(name)
            place[:], pair[:] = self.row_of(name), value
            if name in self.delays and pair.max(initial=0.0) > self.longest_delay:
                raise InputError(
                    f"{name} is {pair.max():g} s, the delay line of this plant holds {self.longest_delay:g} s"
                )
        self._by_channel(self.memory)[block, places, :, lane] = pairs

    def shift(self, state: str, by: ArrayLike, rows: slice) -> None:
        """Adds `by`, a number or (number of rows, 2), to a state of some rigs. KeyError for a name that is no state here."""
        row = self.row_of(state)
        if row >= self.kernel.rows["time"]:  # states come first
            raise KeyError(f"{state}: is no state of the plant")
        block, lane = self._lanes(rows)
        self._by_channel(self.memory)[block, row, :, lane] += np.asarray(by, float)

    def shift_sent(self, ago: int, by: ArrayLike, rows: slice) -> None:
        """Adds `by` (V), a number or (number of rows, 2), to the command of some rigs that was sent `ago` rows earlier
        (1: the last one) and may still be on its way, within what the valves take."""
        block, lane = self._lanes(rows)
        sent = self._by_channel(self._ring)[:, (self._head + 1 - ago) % self._ring.shape[1]]
        rated = self.get("u_rated")[rows]
        sent[block, :, lane] = np.clip(sent[block, :, lane] + np.asarray(by, float), -rated, rated)

    # --- time -----------------------------------------------------------------------------------------------------
    def reset(self, rows: ArrayLike | None = None) -> None:
        """Puts all rigs, or `rows` (indices or mask), to rest at time zero."""
        moving = self.kernel.rows["load"] + 1  # states and outputs come first, in this order
        if rows is None:
            self.memory[:, :moving, :] = 0.0
            self._ring[:] = 0.0
        else:
            block, lane = self._lanes(rows)
            for cells in (self.memory[:, :moving], self._ring):
                self._by_channel(cells)[block, :, :, lane] = 0.0
        self._observe()

    def _observe(self) -> None:
        """Flow and measured speed from the states as they are: a run through no rows."""
        nothing = self._empty[:, 0]
        self.run_into(self._empty, nothing, nothing, 1.0)

    def take_state(self, other: "Plant", rows: Integers | None = None, parameters: bool = False) -> None:
        """Puts all rigs into the state of another plant's, which may have another tolerance and dtype; rig i into that of the
        other's rig `rows[i]`, where given. `parameters`: gives them their parameters as well.

        ValueError if there are not as many, or other effects.
        """
        kernel = self.kernel
        if (self.num_rigs, self.effects) != (other.num_rigs if rows is None else len(rows), other.effects):
            raise ValueError("take_state needs a plant with as many rigs and the same effects")
        moving = kernel.num_rows if parameters else kernel.rows["load"] + 1
        parts = [(self.memory[:, :moving], other.memory[:, :moving])]
        if kernel.has_delay:
            self._ring = np.zeros((len(self.memory), other._ring.shape[1], 2 * kernel.half))
            self._lasted = np.tile(other._lasted[:1], (len(self.memory), 1))
            self._head = other._head
            parts.append((self._ring, other._ring))
        (block, lane), (from_block, from_lane) = self._lanes(), other._lanes(rows)
        for mine, theirs in parts:
            if rows is None and kernel.half == other.kernel.half:
                mine[:] = theirs
            else:
                part = other._by_channel(theirs)[from_block, :, :, from_lane]
                self._by_channel(mine)[block, :, :, lane] = part

    def select(self, rows: Integers) -> "Plant":
        """Some of the rigs (indices), with parameters and state, as a plant of their own."""
        kernel = self.kernel
        some = Plant(
            self.model, len(rows), effects=kernel.effects, tolerance=self.tolerance, dtype=kernel.dtype, block=kernel.half,
            grouped=kernel.grouped,
        )  # fmt: skip
        some.take_state(self, rows, parameters=True)
        return some

    def _lanes(self, rows: ArrayLike | slice | None = None) -> tuple[Integers, Integers]:
        """Block and lane of each rig, or of `rows` (indices, mask or slice)."""
        rigs = np.arange(self.num_rigs)
        if rows is not None:
            rigs = rigs[rows if isinstance(rows, slice) else np.asarray(rows)].reshape(-1)
        return rigs // self.kernel.half, rigs % self.kernel.half

    def step(self, command_V: ArrayLike, load_Nm: ArrayLike, period: float) -> None:
        """Holds commands (V) and loads (N m), each broadcast to (num_rigs, 2), over `period` s.

        Commands beyond the rated one are clipped. A rig that diverges numerically is put to rest and marked in
        `diverged`, so no signal is ever NaN. ValueError if a command or load is not finite.
        """
        command, load = (np.full((self.num_rigs, 2), each, np.float64) for each in (command_V, load_Nm))
        if not (np.isfinite(command).all() and np.isfinite(load).all()):
            raise ValueError("a command or load is not finite")
        self.hold(command, load, period)

    def hold(self, command_V: Floats, load_Nm: Floats, period: float) -> None:
        """`step` without these checks: finite float64 arrays (num_rigs, 2)."""
        self.run_into(self._empty, command_V[None], load_Nm[None], period, points=grid_points(period))

    def hold_rigs(self, rigs: slice, command_V: Floats, load_Nm: Floats, period: float) -> None:
        """`hold` for a range of rigs, so that threads can share the work: the first one a multiple of `kernel.half`. `make_room`
        was called before; the period is over when all rigs have been held and `turn` was called."""
        half = self.kernel.half
        blocks = slice(rigs.start // half, -(-rigs.stop // half))
        self.kernel.advance(
            self.memory[blocks].reshape(-1), self.kernel.room(), self._ring[blocks] if self.kernel.has_delay else None,
            self._lasted[blocks], self._head, command_V[None, rigs], load_Nm[None, rigs], period, self.tolerance, _NO_RECORD, 1,
            self._empty[:, :, rigs], grid_points(period),
        )  # fmt: skip

    def turn(self, rows: int) -> None:
        """Moves the delay line on by `rows`, after `hold_rigs`."""
        self._head = (self._head + rows) % self._ring.shape[1]

    def run(
        self, command_V: Floats, load_Nm: Floats | None, period: float, record: Sequence[str] = ("speed",),
        every: int = 1,
    ) -> dict[str, Floats]:  # fmt: skip
        """Runs through all rows of a command sequence in one call.

        `command_V`: (T, 2) for all rigs or (T, num_rigs, 2); `load_Nm` likewise, (1, 2), or None for no load. Returns
        signals (ceil(T / every), num_rigs, 2) at the instant of each row, *before* its command acts: row 0 is the state
        as it is now. ValueError for wrong shapes or values that are not finite.
        """
        command = _sequence(command_V, self.num_rigs, "command_V")
        load = np.zeros((1, 1, 2)) if load_Nm is None else _sequence(load_Nm, self.num_rigs, "load_Nm")
        if load.shape[0] not in (1, command.shape[0]):
            raise ValueError(f"load_Nm has {load.shape[0]} rows, command_V has {command.shape[0]}")
        rows = np.array([self.row_of(name) for name in record], dtype=np.int64)
        out = np.empty((len(record), -(-command.shape[0] // every), self.num_rigs, 2))
        self.run_into(out, command, load, period, rows, every)
        return dict(zip(record, out, strict=True))

    def run_into(
        self, out: Floats, command_V: Floats, load_Nm: Floats, period: float, rows: Integers = _NO_RECORD,
        every: int = 1, points: int = 0,
    ) -> None:  # fmt: skip
        """`run` without its checks: finite float64 arrays (T, num_rigs, 2) or with ones for T of the load or num_rigs,
        the numbers `row_of` the signals, and where they go, `out` (signals, ceil(T / every), num_rigs, 2). `points` as for
        `kernel.driver.advance`.
        """
        if not period > 0.0:
            raise ValueError(f"period is {period}, expected more than 0 s")
        self.make_room(period)
        self.kernel.advance(
            self.memory.reshape(-1), self._cells, self._ring if self.kernel.has_delay else None, self._lasted, self._head,
            command_V, load_Nm, period, self.tolerance, rows, every, out, points,
        )  # fmt: skip
        self.turn(command_V.shape[0])

    @property
    def delay(self) -> Floats:
        """By how much the commands are late, (num_rigs, 2), s."""
        return np.sum([np.zeros((self.num_rigs, 2)), *map(self.get, self.delays)], axis=0)

    @property
    def angle_acts(self) -> bool:
        """Whether an effect goes by the shaft's angle; without one it is the integral of the speed and nothing else."""
        return any(CATALOGUE[name].reads("angle") for name in self.effects)

    # --- signals --------------------------------------------------------------------------------------------------
    current: Floats = _signal("current", "Coil currents, A.")
    spool: Floats = _signal("spool", "Spool positions, m.")
    spool_speed: Floats = _signal("spool_speed", "Spool speeds, m/s.")
    pressure: Floats = _signal("pressure", "Pressure differences over the motors, Pa.")
    speed: Floats = _signal("speed", "Shaft speeds, rad/s.")
    measured_speed: Floats = _signal(
        "measured_speed", "Shaft speeds as the sensors show them (lag, gain, offset; no noise), rad/s."
    )
    angle: Floats = _signal("angle", "Shaft angles since the reset, rad.")
    flow: Floats = _signal("flow", "Flows through the valves, m3/s.")

    @property
    def time(self) -> Floats:
        """Time since the reset, s, (num_rigs,)."""
        return self.get("time")[:, 0]

    @property
    def diverged(self) -> Bools:
        """Rigs that diverged numerically since their reset, (num_rigs,)."""
        marked = self.get("diverged") > 0.0
        return marked[:, 0] | marked[:, 1]

    @property
    def lost(self) -> list[Lost]:
        """What was lost of the rigs that `diverged`: each channel, when and by which state."""
        numbers, times = self.get("diverged"), self.get("lost_at")
        return [
            Lost(rig, channel + 1, float(times[rig, channel]), self.states[int(numbers[rig, channel]) - 1])
            for rig, channel in np.argwhere(numbers > 0.0).tolist()
        ]

    # --- copies ---------------------------------------------------------------------------------------------------
    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_cells"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._cells = self.kernel.room()

    def copy(self) -> "Plant":
        """Rigs of their own with the same parameters and state."""
        return copy.deepcopy(self)


def _sequence(values: Floats, num_rigs: int, name: str) -> Floats:
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.ndim == 2:
        array = array[:, None, :]
    if array.ndim != 3 or array.shape[1] not in (1, num_rigs) or array.shape[2] != 2:
        raise ValueError(f"{name} has the shape {np.shape(values)}, expected (T, 2) or (T, {num_rigs}, 2)")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} has values that are not finite")
    return array


def simulate(
    model: str | Path | PlantModel, command_V: Floats, load_Nm: Floats | None, period: float, *,
    values: Mapping[str, ArrayLike] | None = None, num_rigs: int = 1, record: Sequence[str] = ("speed",),
    every: int = 1, **options: Any,
) -> dict[str, Floats]:  # fmt: skip
    """Simulates a command sequence from rest for `num_rigs` variants of a model.

    `values` maps parameters to arrays that broadcast to (num_rigs, 2); one of shape (num_rigs,) is taken for both
    channels of each rig. Effects named in `values` are compiled in. `options` (effects, tolerance, dtype, block, grouped) as in
    `Plant`, the rest as in `Plant.run`: row n of the result is the state at the instant at which command n begins to act.
    """
    values = dict(values or {})
    named = {name.split(".", 1)[0] for name in values if "." in name}
    options["effects"] = (*options.get("effects", ()), *named)
    plant = Plant(model, num_rigs, **options)
    for name, value in values.items():
        array = np.asarray(value, dtype=np.float64)
        plant.set(name, array[:, None] if array.shape == (num_rigs,) else array)
    plant.reset()
    return plant.run(command_V, load_Nm, period, record, every)
