"""The dynamic plant as a model of the diagnosis: many parameter variants as lanes of the batched kernel."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from heapq import heapreplace
from math import exp, gcd, isnan, sqrt
from typing import Any

import numpy as np

from ...plant import CATALOGUE, PARAMETERS, Effect, Parameter, Plant, PlantModel
from ...plant.catalogue.form_corrections import CORRECTIONS, FAMILY
from ..input.parts import Part
from .base import Request, Segments, given_parameters, measured_segments, view

__all__ = ["DynamicRig"]

#: Longest substep of the fit and of the proof, s. With 250 us the speeds of the presets are off by less than 0.4 rpm, under
#: steps and commands of full range (a test).
SUBSTEP, PROOF_SUBSTEP = 250e-6, 100e-6
#: Where an effect has every substep taken in parts, the substep is the longest of which these are at most so long in the fit and
#: in the proof, and never longer than the last number, s. Preloaded springs are 0.02 rpm off in the fit in a log of 12 s, at most
#: 0.13. The proof takes 200 us for them and 400 us for a backlash, which is below 0.01 rpm in 3 s (a test); a shaft that rattles
#: for longer ends rpm away with any substep.
PARTED_SUBSTEP, PARTED_PROOF, LONGEST_SUBSTEP = 100e-6, 20e-6, 1e-3
#: Numbers of the fit and of the proof. Single precision moves a speed by less than the fit's substep does, and by more than the
#: proof's does.
DTYPE, PROOF_DTYPE = np.float32, np.float64
#: By numbers: how many rigs go through the kernel together, and how long that takes. Wider blocks take as long as several.
BLOCKS: dict[type[np.floating[Any]], dict[int, float]] = {
    np.float32: {4: 0.7, 8: 1.0},
    np.float64: {4: 1.0},
}
#: What an effect that is compiled in adds to the time of a kernel without any.
EFFECT_SHARE = 0.06
#: Time in which a speed that follows the measured one comes near it, s: shorter than a blow of a coupling takes to come back.
FOLLOW_S = 3e-3
#: Bytes of inputs of batches that are kept, about. Those of eight lanes of 12 s at 1 kHz take 3 MB.
MOST_INPUTS = 100_000_000
#: Base parameters that calibration may adjust. V is left out (never separated from beta), u_rated and x_max are settings.
BASE = ("D", "J", "B", "Km", "beta", "m", "R", "L", "alpha", "k", "Kq", "Fc", "Fs", "vs")
_RECORDED = {
    "speed": "measured_speed",
    "current": "current",
    "pressure": "pressure",
    "spool": "spool",
    "flow": "flow",
    "mean_line_pressure": "mean_line_pressure",
}


@dataclass(frozen=True)
class _Batch:
    """Lanes that go through a kernel together: its effects, the substep and the period of the logs, s, the block, and how long
    each unit of `BLOCKS` takes. A lane is a rig that runs through a log: the number of the log, and one request number for each
    side of the rig, or one for both."""

    effects: tuple[str, ...]
    step: float
    period: float
    lanes: list[tuple[int, list[int]]]
    block: int
    weight: float


class DynamicRig:
    """See `base.RigModel`. `progress` is called with the number of rig simulations done."""

    def __init__(
        self, model: PlantModel, parts: list[Part], *, every_row: bool = False, substep: float = SUBSTEP,
        dtype: type[np.floating[Any]] = DTYPE, jobs: int = 1, progress: Callable[[int], None] | None = None,
        without: frozenset[str] = frozenset(),
    ) -> None:  # fmt: skip
        self.without, self.dtype = without, dtype
        self.model, self.parts, self.substep, self.jobs, self.progress = model, parts, substep, jobs, progress
        self.channels = tuple(c for c in (0, 1) if any(c in part.log.channels for part in parts))
        self.segments: dict[int, Segments] = measured_segments(
            parts, self.channels, tuple(_RECORDED), every_row
        )
        self.signals = tuple(
            s for s in _RECORDED if any(seg.signal == s for segs in self.segments.values() for seg in segs)
        )
        self.period = min(part.log.period for part in parts)
        #: Numbers of the logs by their period, s, the longest first: logs of about the same length run side by side.
        self._logs: dict[float, list[int]] = {}
        for number in sorted(range(len(parts)), key=lambda n: -len(parts[n].log)):
            self._logs.setdefault(parts[number].log.period / parts[number].finer, []).append(number)
        self._pairs: dict[str, np.ndarray] = {}
        rows, most = max(len(part.log) * part.finer for part in parts), max(BLOCKS[dtype])
        # The same lanes are asked for again and again, by several threads.
        self._inputs = lru_cache(MOST_INPUTS // (32 * rows * most))(partial(_inputs, tuple(parts)))
        #: A plant of the model for each effects, substep, number of rigs and block, of which every batch takes a copy: to make
        #: one takes longer than to copy it.
        self._plants: dict[tuple[tuple[str, ...], float, int, int], Plant] = {}
        self.every_row = every_row
        # The plant's kernel lets other threads of this process run beside it.
        self._pool = ThreadPoolExecutor(jobs) if jobs > 1 else None
        self.coupled = any(CATALOGUE[e].scope == "rig" for e in model.declared)
        #: Effects that every simulation has, whatever is asked for.
        self._declared = frozenset(model.declared)
        names = [*PARAMETERS, *(f"{e}.{p.name}" for e in model.declared for p in CATALOGUE[e].parameters)]
        self._unequal = {name for name in names if model.value(name, 0) != model.value(name, 1)}
        self.simulation_is_cheap, self.has_hidden_states = False, True
        #: Channels whose simulated speed follows the measured one.
        self.followed: frozenset[int] = frozenset()
        #: Whether a set of effects has a kernel of its own, see `kernel`.
        self.own_kernels = False
        self.notes: list[str] = []
        self.own: dict[str, Parameter] = {}
        library = {*self.candidates(), *without}
        cheap = {n: e for n, e in CATALOGUE.items() if n in library and e.is_cheap}
        leaks = frozenset(n for n, e in cheap.items() if "leakage" in e.laws)
        #: Effects that share a kernel. To a kernel each state adds a tenth. The slope of the leakage is a difference over all
        #: effects on it, in which rounding shows: so they are always together.
        self._shared = frozenset(n for n, e in cheap.items() if not e.states) - leaks, leaks

    def with_parts(self, parts: list[Part], every_row: bool) -> DynamicRig:
        return DynamicRig(
            self.model,
            parts,
            every_row=every_row,
            substep=PROOF_SUBSTEP,
            dtype=PROOF_DTYPE,
            jobs=self.jobs,
            progress=self.progress,
            without=self.without,
        )

    def for_long_refits(self) -> DynamicRig:
        return view(self, own_kernels=True)

    def following(self, channels: Collection[int]) -> DynamicRig:
        # An uneven log is simulated on a finer grid than it is measured on.
        return view(self, followed=frozenset(() if any(p.held is not None for p in self.parts) else channels))

    def written(self, values: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
        return dict(values)

    def base(self, channel: int) -> list[str]:
        # A spool that is given as without dry friction has none to adjust; what it has all the same is an effect.
        own = [n for n in BASE if n not in ("Fc", "Fs") or self.given(n, channel) > 0.0]
        return own + given_parameters(self, channel)

    def candidates(self) -> list[str]:
        both = len(self.channels) == 2
        return [
            e.name
            for e in CATALOGUE.values()
            if (both or not e.couples_channels)
            and e.name not in self.without
            and not all(self.has(e.name, c) for c in (self.channels if e.scope == "channel" else (None,)))
            and e.family != FAMILY
            and (not e.family or e.name in self.model.declared)
        ]

    def has(self, effect: str, channel: int | None) -> bool:
        acts, channels = self.model.effects.get(effect), self.channels if channel is None else (channel,)
        return acts is not None and any(not CATALOGUE[effect].is_neutral(acts[c]) for c in channels)

    def given(self, name: str, channel: int) -> float:
        return self.model.value(name, channel)

    # --- simulation -----------------------------------------------------------------------------------------------------
    def predict(self, requests: Sequence[Request]) -> list[dict[int, np.ndarray]]:
        # Where nothing ties the channels together, a rig is two single channels, of which many are asked for again and again.
        wanted: dict[tuple[object, ...], int] = {}
        single: list[Request] = []
        sides: list[list[tuple[int, int]]] = []
        for request in requests:
            own = []
            for part in self._apart(request):
                number = wanted.setdefault((part.channel, *sorted(part.values.items())), len(single))
                if number == len(single):
                    single.append(part)
                own += [(number, c) for c in self._seen(part)]
            sides.append(own)
        found = self._predict(single)
        return [{c: found[number][c] for number, c in own} for own in sides]

    def _apart(self, request: Request) -> list[Request]:
        """The request as one for each channel, if they do not act on each other."""
        if (
            request.channel is not None
            or self.coupled
            or any(CATALOGUE[e].couples_channels for e in request.effects)
        ):
            return [request]
        pairs = {name: np.broadcast_to(value, 2).tolist() for name, value in request.values.items()}
        return [
            Request(c, {name: pair[c] for name, pair in pairs.items() if not isnan(pair[c])})
            for c in self.channels
        ]

    def _predict(self, requests: Sequence[Request]) -> list[dict[int, np.ndarray]]:
        results = [{c: np.empty(self.segments[c][-1].place.stop) for c in self._seen(r)} for r in requests]
        by_kernel: dict[tuple[tuple[str, ...], int, float], list[int]] = {}
        for number, request in enumerate(requests):
            # Rigs are simulated in step: one that takes its substeps in parts holds up those beside it.
            parts = max((_parts(CATALOGUE[e]) for e in request.effects), default=1)
            key = (self.kernel(request.effects), parts, self._step(request))
            by_kernel.setdefault(key, []).append(number)
        batches: list[_Batch] = []
        widths = BLOCKS[self.dtype]
        for (effects, parts, step), numbers in by_kernel.items():
            rigs = self._pack([(n, requests[n]) for n in numbers])
            for period, logs in self._logs.items():
                lanes = [(log, rig) for log in logs for rig in rigs]
                rows = max(len(self.parts[log].log) * self.parts[log].finer for log in logs)
                weight = rows * period / step * parts * (1.0 + EFFECT_SHARE * len(effects))
                for start in range(0, len(lanes), max(widths)):
                    own = lanes[start : start + max(widths)]
                    batches.append(_Batch(effects, step, period, own, _block(len(own), widths), weight))

        def work(batch: _Batch) -> None:
            self._run(batch, requests, results)

        # A request's result does not depend on who simulates it or beside what; every one has its place in `results`.
        batches = _shared_out(batches, widths, self.jobs)
        for _ in map(work, batches) if self._pool is None else self._pool.map(work, batches):
            pass
        return results

    def kernel(self, effects: frozenset[str]) -> tuple[str, ...]:
        """The effects to compile in; what is neutral changes no bit, but costs time.

        So that few kernels are compiled, candidates share them: one for no effect, one for all light effects, one for those of
        the leakage, one for each other one, and one for it and those it is combined with. Long refits are many of few effects:
        there is one kernel for these and all corrections of their form."""
        effects = effects - self._declared
        if self._of_few(effects):
            forms = {name for effect in effects for name in CORRECTIONS.get(effect, {})}
            return tuple(n for n in CATALOGUE if n in effects or n in forms)
        wanted = effects.union(*(group for group in self._shared if group & effects))
        return tuple(n for n in CATALOGUE if n in wanted)

    def _of_few(self, effects: Collection[str]) -> bool:
        return self.own_kernels or any(CATALOGUE[n].family == FAMILY for n in effects)

    def _step(self, request: Request) -> float:
        """The substep of a request, which does not depend on what is simulated beside it."""
        part = {SUBSTEP: PARTED_SUBSTEP, PROOF_SUBSTEP: PARTED_PROOF}.get(self.substep)
        if part is None or (self.coupled and request.channel is not None):
            return self.substep
        parts = [
            e.corner_parts for e in map(CATALOGUE.__getitem__, request.effects) if _all_parted(e, request)
        ]
        longest = min(max(parts, default=0) * part, LONGEST_SUBSTEP, self.period)
        return max(longest, self.substep)

    def close(self) -> None:
        """Ends the threads, if there are any."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
            self._pool = None

    def _pack(self, wanted: list[tuple[int, Request]]) -> list[list[int]]:
        """Rigs, each a list of request numbers: two of a single channel where the channels do not act on each other.

        Both sides of a rig are alike, so a side may play either channel. As many rigs as there can be play one of each: they have
        the same inputs.
        """
        whole = [[n] for n, r in wanted if self._whole(r)]
        first, second = ([n for n, r in wanted if not self._whole(r) and r.channel == c] for c in (0, 1))
        both = min(len(first), len(second))
        left = first[both:] + second[both:]
        pairs = [list(pair) for pair in zip(first, second, strict=False)]
        return whole + pairs + [left[k : k + 2] for k in range(0, len(left), 2)]

    def _whole(self, request: Request) -> bool:
        """Whether a request takes both sides of a rig."""
        return request.channel is None or self.coupled

    def _run(self, batch: _Batch, requests: Sequence[Request], results: list[dict[int, np.ndarray]]) -> None:
        """Simulates the lanes of a batch and puts what they show into `results`, by request."""
        names = {name for _, rig in batch.lanes for n in rig for name in requests[n].values}
        # Which channel each side of each lane plays.
        plays = np.tile([0, 1], (len(batch.lanes), 1))
        for lane, (_, rig) in enumerate(batch.lanes):
            for side, n in enumerate(rig):
                if not self._whole(requests[n]):
                    plays[lane, side] = requests[n].channel
        if (plays != [0, 1]).any():
            names |= self._unequal
        values = {name: self._pair(name)[plays] for name in names}
        # Which side of which lane shows a channel of a request.
        shown: list[tuple[int, int, int, int]] = []
        for lane, (_, rig) in enumerate(batch.lanes):
            for side, n in enumerate(rig):
                request = requests[n]
                own = slice(None) if request.channel is None else request.channel if self.coupled else side
                for name, value in request.values.items():
                    values[name][lane, own] = np.where(np.isnan(value), values[name][lane, own], value)
                shown += [(lane, c if self._whole(request) else side, n, c) for c in self._seen(request)]
        every, out = self._simulate(batch, values, plays)
        for lane, side, n, channel in shown:
            for segment in self.segments[channel]:
                if segment.log == batch.lanes[lane][0]:
                    signal = segment.taken(out[_RECORDED[segment.signal]][:, lane, side], every)
                    results[n][channel][segment.place] = segment.levelled(signal)
        if self.progress is not None:
            self.progress(len({n for lane, _, n, _ in shown if batch.lanes[lane][0] == 0}))

    def _pair(self, name: str) -> np.ndarray:
        """The values (2,) of a parameter in the model as given."""
        if name not in self._pairs:
            self._pairs[name] = np.array(self.model.pair(name))
        return self._pairs[name]

    def _seen(self, request: Request) -> tuple[int, ...]:
        return self.channels if request.channel is None else (request.channel,)

    def _simulate(
        self, batch: _Batch, values: dict[str, np.ndarray], plays: np.ndarray
    ) -> tuple[int, dict[str, np.ndarray]]:
        """`plays` (lanes, 2): the channel whose command and load each side has. Returns each how many-th row is there, and the
        signals (rows, lanes, 2)."""
        lanes = tuple(
            (log, len(self.parts[log].log) * self.parts[log].finer, *sides)
            for (log, _), sides in zip(batch.lanes, plays.tolist(), strict=True)
        )
        inputs = self._inputs(lanes if len(set(lanes)) > 1 else lanes[:1])
        logs = {log for log, _ in batch.lanes}
        own = [s for segments in self.segments.values() for s in segments if s.log in logs]
        every = gcd(*(s.step if s.late is None else 1 for s in own)) or 1
        with np.errstate(all="ignore"):
            plant = self._plant(batch)
            plant.set_values(values)
            plant.reset()
            signals = [_RECORDED[s] for s in self.signals]
            if self.followed.intersection(plays.flat):
                return 1, self._follow(plant, inputs, lanes, batch.period)
            return every, plant.run(inputs[0], inputs[1], batch.period, signals, every)

    def _follow(
        self, plant: Plant, inputs: np.ndarray, lanes: Sequence[tuple[int, int, int, int]], period: float
    ) -> dict[str, np.ndarray]:
        """Runs as `Plant.run` does, but after each row the speed of a followed channel goes part of the way to the measured one.

        By that the noise of one row is in the speed of the next: the recorded difference is made so much smaller that noise alone
        leaves what it leaves in a free simulation.
        """
        signals = [_RECORDED[s] for s in self.signals]
        rows, speed = np.array([plant.row_of(s) for s in signals]), signals.index(_RECORDED["speed"])
        out = np.empty((len(signals), inputs.shape[1], len(lanes), 2))
        measured, known = np.zeros(out.shape[1:]), np.zeros(out.shape[1:])
        for lane, (number, _, *sides) in enumerate(lanes):
            part = self.parts[number]
            counts = part.inside[:, None] & np.isfinite(part.log.speed) & np.isin((0, 1), [*self.followed])
            measured[: len(part.log), lane] = np.where(counts, part.log.speed, 0.0)[:, sides]
            known[: len(part.log), lane] = counts[:, sides]
        share = 1.0 - exp(-period / FOLLOW_S)
        for row, target in enumerate(measured):
            now = slice(row, row + 1)
            plant.run_into(out[:, now], inputs[0, now], inputs[1, now], period, rows)
            error = (target - out[speed, row]) * known[row]
            plant.shift("speed", share * error, slice(None))
            out[speed, row] += (1.0 - sqrt(1.0 - 0.5 * share)) * error
        return dict(zip(signals, out, strict=True))

    def _plant(self, batch: _Batch) -> Plant:
        key = batch.effects, batch.step, len(batch.lanes), batch.block
        if key not in self._plants:
            self._plants[key] = Plant(
                self.model,
                key[2],
                effects=batch.effects,
                substep=batch.step,
                dtype=self.dtype,
                block=batch.block,
            )
        return self._plants[key].copy()


def _inputs(parts: Sequence[Part], lanes: Sequence[tuple[int, int, int, int]]) -> np.ndarray:
    """Commands and loads (2, rows, lanes, 2) of lanes: each the number of a log, its first so many rows, and the channel that
    each side plays."""
    found = np.zeros(
        (2, max(rows for _, rows, *_ in lanes), len(lanes), 2)
    )  # a lane whose log has ended is at rest
    for kind in dict.fromkeys(lanes):
        number, rows, *sides = kind
        part, alike = parts[number], [n for n, other in enumerate(lanes) if other == kind]
        if part.held is not None:
            found[:, :rows, alike] = part.held[:, :rows, None, sides]
            continue
        found[0, :rows, alike] = np.nan_to_num(part.log.command_V[:rows, sides])
        if part.log.load is not None:
            found[1, :rows, alike] = np.nan_to_num(part.log.load[:rows, sides])
    return found


def _block(count: int, widths: Mapping[int, float]) -> int:
    """The block for so many rigs."""
    return min(width for width in widths if width >= count)


def _shared_out(batches: Sequence[_Batch], widths: Mapping[int, float], jobs: int) -> list[_Batch]:
    """The batches, the longest first, cut as far as `jobs` threads are then done earlier."""

    def time(batch: _Batch) -> float:
        return batch.weight * widths[batch.block]

    def done(ordered: Sequence[_Batch]) -> float:
        ends = [0.0] * jobs
        for batch in ordered:
            heapreplace(ends, ends[0] + time(batch))
        return max(ends)

    ordered = sorted(batches, key=time, reverse=True)
    while True:
        long = next((b for b in ordered if b.block > min(widths)), None)
        if long is None:
            return ordered
        middle = (len(long.lanes) + 1) // 2
        halves = [
            replace(long, lanes=lanes, block=_block(len(lanes), widths))
            for lanes in (long.lanes[:middle], long.lanes[middle:])
        ]
        finer = sorted([*(b for b in ordered if b is not long), *halves], key=time, reverse=True)
        if done(finer) >= done(ordered):
            return ordered
        ordered = finer


def _parts(effect: Effect) -> int:
    return effect.corner_parts if effect.corner is not None else 1


def _all_parted(effect: Effect, request: Request) -> bool:
    """Whether the effect has every substep taken in parts, wherever the rig is and on all of its channels."""
    if effect.corner is None:
        return False
    own = {p.name: request.values.get(f"{effect.name}.{p.name}", p.nominal) for p in effect.parameters}
    sides = (
        dict(zip(own, side, strict=True))
        for side in zip(*(np.broadcast_to(v, 2) for v in own.values()), strict=True)
    )
    return all(effect.parts_every_step(side) for side in sides)
