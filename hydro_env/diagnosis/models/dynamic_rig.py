"""The dynamic plant as a model of the diagnosis: many parameter variants as lanes of the batched kernel."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from itertools import zip_longest
from math import exp, gcd, sqrt
from typing import Any

import numpy as np

from ...plant import CATALOGUE, PARAMETERS, Plant, PlantModel
from ...plant.catalogue.form_corrections import CORRECTIONS, FAMILY
from ...units import RPM
from ..input.parts import Part
from .base import UNITS, Progress, Request, RigModel, Samples, given_parameters

#: Tolerances of the fit and of the proof, rad/s: speeds are off by about 0.03 and 0.003 rpm (RMS; their noise is about 1 rpm).
#: With more in the fit its costs become rough: it takes more simulations than it saves time for.
TOLERANCE, PROOF_TOLERANCE = 0.1 * RPM, 0.03 * RPM
#: Numbers of the fit and of the proof: twice as many in single precision fit a vector instruction.
DTYPE, PROOF_DTYPE = np.float32, np.float64
#: Rigs that go through the kernel together, the lanes of a vector instruction: every width has kernels of its own to compile.
BLOCK = 8
#: Rigs of a batch where Python takes longer than the kernel: after each row of a speed that follows the measured one, and around
#: logs of fewer rows than this, such as early windows (docs/evidence/notes.md).
WIDE_BATCH, FEW_ROWS = 4 * BLOCK, 1000
#: Time in which a speed that follows the measured one comes near it, s: shorter than a blow of a coupling takes to come back.
FOLLOW_S = 3e-3
#: Bytes of inputs of batches that are kept, about: those of eight lanes of 12 s at 1 kHz take 3 MB, and one request for all
#: candidates has some thirty batches.
MAX_INPUTS = 100_000_000
#: Base parameters that calibration may adjust. V is left out (never separated from beta), u_rated and x_max are settings.
BASE = ("D", "J", "B", "Km", "beta", "m", "R", "L", "alpha", "k", "Kq", "Fc", "Fs", "vs")
#: What the plant calls each signal.
_RECORDED = {name: name for name in UNITS} | {"speed": "measured_speed"}
#: The number of a request, and a channel.
Side = tuple[int, int]
#: The number of a log, its rows, and the channel that each side plays.
Lane = tuple[int, int, int, int]
#: Values by name of a parameter or signal.
Values = dict[str, np.ndarray]


@dataclass(frozen=True)
class _Batch:
    """Lanes that go through a kernel together: its effects, the period of the logs, s, and whether all take the steps of the
    first. A lane is a rig that runs through a log: the number of the log, and for one side or both a request and the channel that
    it plays."""

    effects: tuple[str, ...]
    period: float
    lanes: list[tuple[int, list[Side]]]
    grouped: bool = False


class DynamicRig(RigModel):
    """See `base.RigModel`. `jobs` threads simulate, with this `tolerance` (rad/s) and these numbers (`dtype`)."""

    def __init__(
        self, model: PlantModel, parts: list[Part], *, every_row: bool = False, tolerance: float = TOLERANCE,
        dtype: type[np.floating[Any]] = DTYPE, jobs: int = 1, progress: Progress = None, without: frozenset[str] = frozenset(),
    ) -> None:  # fmt: skip
        super().__init__(model, parts, tuple(_RECORDED), every_row, progress, without)
        self.tolerance, self.dtype, self.jobs = tolerance, dtype, jobs
        #: Numbers of the logs by their period, s, the longest first: logs of about the same length run side by side.
        self._logs: dict[float, list[int]] = {}
        for number in sorted(range(len(parts)), key=lambda n: -len(parts[n].log)):
            self._logs.setdefault(parts[number].log.period / parts[number].finer, []).append(number)
        rows = max(len(part.log) * part.finer for part in parts)
        # The same lanes are asked for again and again, by several threads.
        self._new_inputs = partial(_inputs, tuple(parts))
        self._inputs = lru_cache(MAX_INPUTS // (32 * rows * BLOCK))(self._new_inputs)
        #: A plant of the model for each number of rigs, effects and way of stepping, of which every batch takes a copy: to
        #: make one takes longer than to copy it.
        self._plant = cache(partial(Plant, model, tolerance=tolerance, dtype=dtype, block=BLOCK))
        # The plant's kernel lets other threads of this process run beside it. They end with the last view of the rig.
        self._pool = ThreadPoolExecutor(jobs) if jobs > 1 else None
        self.coupled = any(CATALOGUE[e].scope == "rig" for e in model.declared)
        #: Effects that every simulation has, whatever is asked for.
        self._declared = frozenset(model.declared)
        names = [*PARAMETERS, *(f"{e}.{p.name}" for e in model.declared for p in CATALOGUE[e].parameters)]
        self._unequal = {name for name in names if model.value(name, 0) != model.value(name, 1)}
        library = {*self.candidates(), *without}
        cheap = {n: e for n, e in CATALOGUE.items() if n in library and e.is_cheap}
        leaks = frozenset(n for n, e in cheap.items() if "leakage" in e.laws)
        #: Effects that share a kernel. To a kernel each state adds a tenth. The slope of the leakage is a difference over all
        #: effects on it, in which rounding shows: so they are always together.
        self._shared = frozenset(n for n, e in cheap.items() if not e.states) - leaks, leaks

    def with_parts(self, parts: list[Part], every_row: bool) -> "DynamicRig":
        return DynamicRig(
            self.model, parts, every_row=every_row, tolerance=PROOF_TOLERANCE, dtype=PROOF_DTYPE, jobs=self.jobs,
            progress=self.progress, without=self.without,
        )  # fmt: skip

    def following(self, channels: Collection[int]) -> "DynamicRig":
        # An uneven log is simulated on a finer grid than it is measured on.
        return self.view(followed=frozenset(() if any(p.held is not None for p in self.parts) else channels))

    def base(self, channel: int) -> list[str]:
        # A spool that is given as without dry friction has none to adjust; what it has all the same is an effect.
        own = [n for n in BASE if n not in ("Fc", "Fs") or self.given(n, channel) > 0.0]
        return own + given_parameters(self, channel)

    def supported(self) -> list[str]:
        both, declared = len(self.channels) == 2, self.model.declared
        every = (e for e in CATALOGUE.values() if both or not e.couples_channels)
        return [e.name for e in every if not e.family or (e.family != FAMILY and e.name in declared)]

    # --- simulation -----------------------------------------------------------------------------------------------------
    def predict(self, requests: Sequence[Request]) -> list[Samples]:
        # Where nothing ties the channels together, a rig is two single channels, of which many are asked for again and again.
        numbers: dict[tuple[object, ...], int] = {}
        single: list[Request] = []
        first: list[int] = []  # whose steps each one takes

        def number(part: Request) -> int:
            like = None if part.like is None else number(part.like)
            if like is not None and part.values == single[like].values:
                return like
            found = numbers.setdefault((like, part.channel, *sorted(part.values.items())), len(single))
            if found == len(single):
                single.append(part)
                first.append(found if like is None else like)
            return found

        sides = [[(number(p), c) for p in self._apart(r) for c in self._seen(p)] for r in requests]
        results = self._predict(single, first)
        return [{c: results[number][c] for number, c in own} for own in sides]

    def _apart(self, request: Request) -> list[Request]:
        """The request as one for each channel, if they do not act on each other."""
        tied = self.coupled or any(CATALOGUE[e].couples_channels for e in request.effects)
        if request.channel is not None or tied:
            return [request]
        like = [None] * 2 if request.like is None else self._apart(request.like)
        return [Request(c, request.on(c), one) for c, one in zip(self.channels, like, strict=False)]

    def _predict(self, requests: Sequence[Request], first: Sequence[int]) -> list[Samples]:
        results = [{c: np.empty(self.segments[c][-1].place.stop) for c in self._seen(r)} for r in requests]
        families: dict[int, list[int]] = {}
        for n, leader in enumerate(first):
            families.setdefault(leader, []).extend([n] if n != leader else [])

        def run(batches: Iterable[_Batch]) -> set[int]:
            work = partial(self._run, requests=requests, results=results)
            lost = map(work, batches) if self._pool is None else self._pool.map(work, batches)
            return {n for each in lost for n in each if first[n] != n}

        # A request's result does not depend on who simulates it or beside what; every one has its place in `results`.
        lost = run([*self._free(requests, families), *self._groups(requests, families)])
        # What cannot be followed in the steps of another one takes its own.
        run(self._free(requests, {n: [] for n in sorted(lost)}))
        return results

    def _free(self, requests: Sequence[Request], families: Mapping[int, list[int]]) -> Iterator[_Batch]:
        """Batches of those that take steps of their own and that no other one follows."""
        by_kernel: dict[tuple[str, ...], list[int]] = {}
        for n, others in families.items():
            if not others:
                by_kernel.setdefault(self.kernel(requests[n].effects), []).append(n)
        for effects, numbers in by_kernel.items():
            rigs = self._pack([self._sides(n, requests[n]) for n in numbers])
            for period, logs in self._logs.items():
                lanes = [(log, rig) for log in logs for rig in rigs]
                width = WIDE_BATCH if self._wide else BLOCK
                for n in range(0, len(lanes), width):
                    yield _Batch(effects, period, lanes[n : n + width])

    def _groups(self, requests: Sequence[Request], families: Mapping[int, list[int]]) -> Iterator[_Batch]:
        """Batches of those that take the steps of another one, which is the first of each. A side of a block is all of one."""
        sides: dict[tuple[tuple[str, ...], bool], list[list[int]]] = {}
        for leader, others in families.items():
            effects = self.kernel(frozenset().union(*(requests[n].effects for n in (leader, *others))))
            whole = len(self._sides(leader, requests[leader])) == 2
            for n in range(0, len(others), BLOCK - 1):
                sides.setdefault((effects, whole), []).append([leader, *others[n : n + BLOCK - 1]])
        for (effects, whole), every in sides.items():
            step, blocks = 1 if whole else 2, []
            for both in (every[n : n + step] for n in range(0, len(every), step)):
                # The shorter side has the one whose steps it takes again.
                rows = [[own[n if n < len(own) else 0] for own in both] for n in range(max(map(len, both)))]
                blocks.append([[side for n in row for side in self._sides(n, requests[n])] for row in rows])
            for period, logs in self._logs.items():
                lanes = [[(log, rig) for rig in rigs] for rigs in blocks for log in logs]
                if self._wide:  # several blocks together, each filled up with its first lane
                    filled = [lane for own in lanes for lane in (*own, *own[:1] * (BLOCK - len(own)))]
                    lanes = [filled[n : n + WIDE_BATCH] for n in range(0, len(filled), WIDE_BATCH)]
                yield from (_Batch(effects, period, own, grouped=True) for own in lanes)

    def kernel(self, effects: frozenset[str]) -> tuple[str, ...]:
        """The effects to compile in; what is neutral changes no bit, but costs time.

        So that few kernels are compiled, candidates share them: one for no effect, one for all light effects, one for those of
        the leakage, one for each other one, and one for it and those it is combined with; and one for an effect with all
        corrections of its form."""
        effects = effects - self._declared
        if any(CATALOGUE[n].family == FAMILY for n in effects):
            wanted = effects.union(name for effect in effects for name in CORRECTIONS.get(effect, {}))
        else:
            wanted = effects.union(*(group for group in self._shared if group & effects))
        return tuple(n for n in CATALOGUE if n in wanted)

    def _pack(self, wanted: list[list[Side]]) -> list[list[Side]]:
        """Rigs: two of a single channel make one where the channels do not act on each other.

        Both sides of a rig are alike, so a side may play either channel. As many rigs as there can be play one of each: they have
        the same inputs.
        """
        single = sorted((sides[0] for sides in wanted if len(sides) == 1), key=lambda side: side[1])
        half = -(-len(single) // 2)
        pairs = zip_longest(single[:half], single[half:])
        return [sides for sides in wanted if len(sides) == 2] + [[s for s in pair if s] for pair in pairs]

    @property
    def _wide(self) -> bool:
        """Whether batches are wide ones."""
        return bool(self.followed) or max(len(part.log) * part.finer for part in self.parts) < FEW_ROWS

    def _sides(self, number: int, request: Request) -> list[Side]:
        """What a request takes of a rig: both sides, or one alone."""
        whole = request.channel is None or self.coupled
        return [(number, c) for c in (0, 1) if whole or request.channel == c]

    def _run(self, batch: _Batch, requests: Sequence[Request], results: list[Samples]) -> list[int]:
        """Simulates the lanes of a batch and puts what they show into `results`, by request; which of these diverged."""
        rigs = enumerate(rig for _, rig in batch.lanes)
        every_side = [(lane, side, n, c) for lane, rig in rigs for side, (n, c) in enumerate(rig)]
        # Which channel each side of each lane plays.
        plays = np.tile([0, 1], (len(batch.lanes), 1))
        for lane, side, _, c in every_side:
            plays[lane, side] = c
        names = {name for _, _, n, _ in every_side for name in requests[n].values}
        if (plays != [0, 1]).any():
            names |= self._unequal
        values = {name: np.array(self.model.pair(name))[plays] for name in names}
        for lane, side, n, c in every_side:
            for name, value in requests[n].on(c).items():
                values[name][lane, side] = value
        every, out, diverged = self._simulate(batch, values, plays)
        shown = [each for each in every_side if each[3] in results[each[2]]]
        for lane, side, n, c in shown:
            for segment in self.segments[c]:
                if segment.log == batch.lanes[lane][0]:
                    signal = out[_RECORDED[segment.signal]][:, lane, side]
                    results[n][c][segment.place] = segment.taken(signal, every)
        if self.progress is not None:
            self.progress(len({n for lane, _, n, _ in shown if batch.lanes[lane][0] == 0}))
        return [n for lane, side, n, _ in shown if diverged[lane, side]]

    def _seen(self, request: Request) -> tuple[int, ...]:
        return self.channels if request.channel is None else (request.channel,)

    def _simulate(self, batch: _Batch, values: Values, plays: np.ndarray) -> tuple[int, Values, np.ndarray]:
        """`plays` (lanes, 2): the channel whose command and load each side has. Returns the step from one row that
        is there to the next, the signals (rows, lanes, 2), and what diverged (lanes, 2)."""
        rows = [len(part.log) * part.finer for part in self.parts]
        both = zip(batch.lanes, plays.tolist(), strict=True)
        lanes = tuple((log, rows[log], *sides) for (log, _), sides in both)
        make = self._new_inputs if self.followed else self._inputs  # many lanes are too much to keep
        inputs = make(lanes if len(set(lanes)) > 1 else lanes[:1])
        logs = {log for log, _ in batch.lanes}
        own = [s for segments in self.segments.values() for s in segments if s.log in logs]
        every = gcd(*(s.step if s.late is None else 1 for s in own)) or 1
        with np.errstate(all="ignore"):
            plant = self._plant(len(batch.lanes), effects=batch.effects, grouped=batch.grouped).copy()
            plant.set_values(values)
            plant.reset()
            signals = [_RECORDED[s] for s in self.signals]
            if self.followed.intersection(plays.flat):
                every, out = 1, self._follow(plant, inputs, lanes, batch.period)
            else:
                out = plant.run(inputs[0], inputs[1], batch.period, signals, every)
            return every, out, plant.get("diverged") > 0.0

    def _follow(self, plant: Plant, inputs: np.ndarray, lanes: Sequence[Lane], period: float) -> Values:
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


def _inputs(parts: Sequence[Part], lanes: Sequence[Lane]) -> np.ndarray:
    """Commands and loads (2, rows, lanes, 2) of lanes, of fewer rows on an early window than `parts` has. A lane whose log has
    ended is at rest."""
    found = np.zeros((2, max(rows for _, rows, *_ in lanes), len(lanes), 2))
    for kind in dict.fromkeys(lanes):
        number, rows, *sides = kind
        part, alike = parts[number], [n for n, other in enumerate(lanes) if other == kind]
        held = np.nan_to_num([values[:rows] for values in part.driving]) if part.held is None else part.held
        found[:, :rows, alike] = held[:, :rows, None, sides]
    return found
