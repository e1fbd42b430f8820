"""Logs and model at the beginning of a diagnosis or calibration: read, checked, and held open while it lasts."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

from threadpoolctl import threadpool_limits

from ..errors import InputError
from ..measured import Mapping, RigLog
from ..plant import PlantModel, load_model
from .estimation.fit import Fit
from .input.checks import read_logs
from .input.parts import Part
from .logs import Logs
from .models.base import RigModel
from .models.dynamic_rig import DynamicRig
from .models.steady_valve import SteadyValve
from .settings import Settings
from .stages import row_times


@contextmanager
def opened(
    fit: Sequence[str | Path | RigLog], held_out: Sequence[str | Path | RigLog] | None, model: str | Path | PlantModel,
    mapping: Mapping | str | Path | None, accept: Collection[str], *, steady: bool, jobs: int, settings: Settings,
    count: Callable[[int], None], without: Collection[str] = (),
) -> Iterator[Logs]:  # fmt: skip
    """The logs with a model of the rig, closed at the end; arguments as in `diagnose`. Without logs that are `held_out` (None)
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
    with threadpool_limits(1, "blas"), ExitStack() as at_end:
        parts, proofs = read_logs(fit, held_out, mapping, accept)
        with closing(rig_of(parts)) as first:
            parts, proofs = row_times.settled(first, parts), row_times.settled(first, proofs)
        rig = at_end.enter_context(closing(rig_of(parts)))
        # Where the dynamics are simulated, the proof has a tighter tolerance than the fit.
        fine = at_end.enter_context(closing(rig.with_parts(parts, False))) if rig.has_hidden_states else rig
        others = at_end.enter_context(closing(rig.with_parts(proofs, True))) if proofs else fine
        yield Logs(Fit(rig, {}, settings), fine, others)
