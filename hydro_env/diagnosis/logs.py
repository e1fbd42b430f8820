"""What all stages work on: a model of the rig with its logs, read and checked at the beginning of a diagnosis or calibration."""

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from threadpoolctl import threadpool_limits

from ..errors import InputError
from ..measured import Mapping, RigLog
from ..plant import PlantModel, load_model
from .estimation.fit import Fit
from .input.checks import read_logs
from .input.parts import Part
from .models.base import RigModel
from .models.dynamic_rig import DynamicRig
from .models.steady_valve import SteadyValve
from .settings import Settings
from .stages import row_times


@dataclass(frozen=True)
class Logs:
    """The model of the rig with all logs: `fit` with those to fit and their noise, `fine` the same with the accuracy of the
    proof, `held_out` with those that take no part in the fit."""

    fit: Fit
    fine: RigModel
    held_out: RigModel

    @property
    def rig(self) -> RigModel:
        return self.fit.rig

    @property
    def seconds(self) -> float:
        """Length of the longest log to fit, s."""
        return max(len(p.log) * p.log.period for p in self.rig.parts)

    def following(self, channels: Collection[int]) -> "Logs":
        """The same with the simulated speed of these channels drawn to the measured one."""
        fine, held_out = (rig.following(channels) for rig in (self.fine, self.held_out))
        return Logs(self.fit.on(self.rig.following(channels)), fine, held_out)


@contextmanager
def opened(
    fit: Sequence[str | Path | RigLog], held_out: Sequence[str | Path | RigLog] | None, model: str | Path | PlantModel,
    mapping: Mapping | str | Path | None, accept: Collection[str], *, steady: bool, jobs: int, settings: Settings,
    count: Callable[[int], None], without: Collection[str] = (),
) -> Iterator[Logs]:  # fmt: skip
    """The logs with a model of the rig; arguments as in `diagnose`. Without logs that are `held_out` (None)
    those to fit stand for them. `count` is called with the number of simulations done.

    It is the reduced steady-valve model for cylinders, or where `steady` is wanted, else the dynamic plant. InputError for logs
    of motors and cylinders, and for all that cannot be used.
    """
    given = load_model(model)

    def rig_of(parts: list[Part]) -> RigModel:
        kinds = {part.log.kinds[c] for part in parts for c in part.log.channels}
        if len(kinds) > 1:
            raise InputError("the mapping mixes motors and cylinders; diagnose one kind at a time")
        if steady or kinds == {"cylinder"}:
            return SteadyValve(given, parts, progress=count, without=frozenset(without))
        return DynamicRig(given, parts, jobs=jobs, progress=count, without=frozenset(without))

    # Threads of the linear algebra would wait for each other and for those that simulate: its matrices are narrow.
    with threadpool_limits(1, "blas"):
        parts, proofs = read_logs(fit, held_out, mapping, accept)
        first = rig_of(parts)
        parts, proofs = row_times.settled(first, parts), row_times.settled(first, proofs)
        rig = rig_of(parts)
        # Where the dynamics are simulated, the proof has a tighter tolerance than the fit.
        fine = rig.with_parts(parts, False) if rig.has_hidden_states else rig
        others = rig.with_parts(proofs, True) if proofs else fine
        yield Logs(Fit(rig, {}, settings), fine, others)


def place_of(channel: int | None) -> str:
    """ "1" or "2" for a channel, "rig" for None."""
    return "rig" if channel is None else str(channel + 1)
