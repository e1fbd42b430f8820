"""The flow controller, by what it may know of the valves beforehand.

`adaptive_flow` learns edges and gains where the drive happens to take it, and averages its commands. `probing_flow` looks for
them while the rig is at rest, before the set-point first moves, and plans its commands. `bench_flow` begins with what a valve
bench has found: nothing is probed, so that the shafts stand still until the set-point moves; edges and gains go on being
estimated, since friction moves an edge by more than a bench can tell, and since valves change.

Settings were found by an evolution strategy and by hand on pairs of `train` (docs/evidence/notes.md). Those that choose the
place on the Pareto front of speed difference and tracking error are left to the user as gains.
"""

from dataclasses import replace
from typing import ClassVar

from hydro_env.controllers.base import Controller, Floats, Gain, Measurements
from hydro_env.controllers.estimation.bench_map import FromTheBench
from hydro_env.controllers.mpc.edge_search import ProbingSettings
from hydro_env.controllers.mpc.fitted import leaks, settings_of, units_of
from hydro_env.controllers.mpc.flow_controller import FlowController, FlowSettings
from hydro_env.plant import PlantModel, Scales

#: Standard deviations that an edge and a gain from the bench are given, as shares of rated command and rated gain. The bench
#: reads both far better, but friction shifts an edge from one reversal to the next; with less doubt the worst pairs part.
SURE = 0.015, 0.06

RATE = Gain("rate", "1/s", 5.0, 60.0, default=42.0, summary="rate at which a reference runs to the set-point")
RISE = Gain("rise", "1/s", 3.0, 60.0, default=28.0, summary="rated flows a second by which flow may rise")
FALL = Gain("fall", "1", 1.0, 10.0, default=4.0, summary="how many times as fast it may fall")
SWEEP = Gain("sweep", "1/s", 1.0, 6.0, default=2.65, summary="pace of spools when probing, commands a second")
SEARCH = Gain("search", "1/s", 1.0, 20.0, default=9.3, summary="pace of spools when crossing a dead zone")


#: The settings that the gains belong to.
PARTS = {"reference": ("rate", "rise", "fall"), "probing": ("sweep",), "crossing": ("search",)}


class ProbingFlow(Controller):
    """Probes the valves at rest. The drawn valves are unknown to it, the motor is known: from the model, unless it leaks as the
    paper's does. Gains at their default follow from the model too."""

    similar = True
    GAINS: ClassVar[tuple[Gain, ...]] = (RATE, RISE, FALL, SWEEP, SEARCH)
    settings = FlowSettings()
    """Beneath the gains."""

    law: FlowController
    _model: PlantModel | None = None

    def drives(self, model: PlantModel) -> None:
        super().drives(model)
        self._model = None if leaks(model) else model

    def units_for(self, model: PlantModel) -> Scales:
        return units_of(model)

    def take_in(self, measured: Measurements) -> None:
        if self.allowed != Controller.allowed:  # what was sent is not what the law asked for
            self.law.sent = measured.command
        self.law.update(measured)

    def command(self, measured: Measurements) -> Floats:
        return self.law.command()

    def start(self, measured: Measurements) -> None:
        s, gains = self.settings, {name: float(value) for name, value in self.gains.items()}
        if self._model is not None:
            own = settings_of(self._model, self.period)
            s = own._replace(probing=own.probing._replace(active=s.probing.active))
            gains = {g.name: gains[g.name] for g in self.GAINS if gains[g.name] != g.default}

        parts = {
            part: getattr(s, part)._replace(**{name: gains[name] for name in names if name in gains})
            for part, names in PARTS.items()
        }
        self.law = FlowController(s._replace(**parts))
        self.law.start(measured, self.period)


NO_PROBING = FlowSettings(probing=ProbingSettings(active=False))


class AdaptiveFlow(ProbingFlow):
    """Learns the valves while it drives them; commands are averaged, not planned."""

    # chosen on 60 pairs of `train` by the cost that gains are tuned for
    GAINS = (replace(RATE, default=30.0), replace(RISE, default=20.0), FALL, SEARCH)
    settings = NO_PROBING._replace(planner=None)


class BenchFlow(FromTheBench, ProbingFlow):
    """Had the valves on a bench. The paper's motor is known to it."""

    GAINS = (RATE, RISE, FALL)
    settings = NO_PROBING

    def start(self, measured: Measurements) -> None:
        super().start(measured)
        self.law.estimator.valves.begin_with(self.valves.edge, self.valves.gain.mean(axis=-1), *SURE)
