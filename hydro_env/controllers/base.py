"""What a controller is: gains with names and units, `reset`, `act` on observations, one row per rig.

Numbers of its parts that are no gains are settings: small named tuples, which compiled code takes as well. Every field has a
unit, a meaning and a reason for its value; a truth value has the unit "", and no reason where its meaning says it.

    class ReferenceSettings(NamedTuple):
        rate: Annotated[float, "1/s", "how fast the reference runs to the set-point", TUNED] = 42.0
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, log
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from hydro_env.arrays import AnyArray, Bools, Floats, Reals
from hydro_env.controllers.estimation.nominal import SPOOL_RATE
from hydro_env.controllers.input_guard import InputGuard, guarded
from hydro_env.controllers.input_shaping import InputShaper
from hydro_env.envs.observation import Measurements, decode
from hydro_env.errors import InputError, check_known
from hydro_env.plant import PAPER, PARAMETERS, Scales, scales_of
from hydro_env.units import RPM

if TYPE_CHECKING:
    from hydro_env.plant import Plant, PlantModel

__all__ = [
    "FRACTION_PER_V", "HAND", "OUTPUT_SHAPING", "RPM", "TUNED", "Bools", "Controller", "Floats", "Gain", "Measurements", "Rows",
]  # fmt: skip

#: Found by an evolution strategy, or by trial, on pairs of the split `train`; docs/evidence/notes.md has the trials.
TUNED = "tuned on `train`"
#: Chosen once, never searched for.
HAND = "set by hand"

#: Rigs, as an index of arrays.
Rows = AnyArray | slice

#: One volt of command as a fraction of the rated command of the paper's valves.
FRACTION_PER_V = 1.0 / PARAMETERS["u_rated"].nominal


@dataclass(frozen=True)
class Gain:
    """A number of a controller that may be tuned: its unit, the range a tuner searches, and on what scale.

    One with a `default` may be left out.
    """

    name: str
    unit: str
    low: float
    high: float
    log: bool = True
    summary: str = ""
    default: float | None = None

    def size(self, scales: Scales) -> float:
        """What the gain is multiplied by on a rig of these scales."""
        top, _, bottom = self.unit.partition("/")
        return scales.factor(top) / scales.factor(bottom)


#: Gains of the output shaping that all controllers share: no limit and no filter if left out.
OUTPUT_SHAPING = (
    Gain("slew", "V/s", 300.0, 30000.0, summary="how fast a command may change", default=inf),
    Gain("shape", "1", 0.0, 1.0, log=False, default=0.0, summary="share of the command with input shaping"),
)


class Controller:
    """Drives both valves of every rig of a batch from what can be measured there.

    Subclasses list their gains in `GAINS` and implement `start`, `command` and, if need be, `take_in`; anything else with
    a `reset` and an `act` of the same meaning can be benchmarked as well. A gain may be a number, an array (2,) with
    a value per channel, or an array (num_rigs, 1) with a value per rig; the latter is how a tuner tries
    many at once.

    Measurements and gains are those of the rig. A law that is `similar` works in the units of the paper's rig instead (`scales`):
    by similarity every rig is one of that size, so that its constants hold, and gains found there can be carried to others.

    All share the output shaping: a command changes no faster than the gain `slew`, and the share `shape` of it passes the
    filter that leaves the spool's lightly damped mode at rest. `limits` are what a command can be in this sample; a law
    with an integrator passes them on, so that it does not wind up on either limit.

    Class attributes:
        GAINS: the gains the constructor takes, by name.
        needs: privileged information. "measurements": none, the drawn valves are unknown; "bench": each pair was on a
            valve bench beforehand; "parameters": the true valves; "everything": the loads to come as well. All but
            the first get `prepare` called with a copy of the plant, the last one `foresee` too. The leaderboard lists it.
        plant: the plant the controller belongs to where that is another one than the plant under test.
        similar: whether the law works in the units of the paper's rig, once it is told which rig it `drives`.

    `guard` watches what `act` is given (`hydro_env.controllers.input_guard`); its `fault` (num_rigs,) tells of absent inputs.
    """

    GAINS: ClassVar[tuple[Gain, ...]] = ()
    needs: str = "measurements"
    plant: str | None = None
    similar: bool = False
    allowed: tuple[float, float] = (1.0, inf)
    """Largest command, and largest change of it in a second, that the owner of a rig allows, as shares of the rated one."""
    limits: tuple[Floats, Floats]
    """Least and largest command of this sample, each (num_rigs, 2), while `command` works."""
    asked: Floats
    """What `command` returned for this sample, (num_rigs, 2), before it was limited."""
    sent: Floats
    """The command in force, (num_rigs, 2)."""

    def __init__(self, name: str | None = None, /, **gains: Any) -> None:
        self.name = name or type(self).__name__
        known = [gain.name for gain in self.GAINS]
        optional = {gain.name: gain.default for gain in self.GAINS if gain.default is not None}
        gains = {**optional, **gains}
        check_known(f"{self.name}: unknown gain", gains, known)
        missing = [key for key in known if key not in gains]
        if missing:
            raise InputError(f"{self.name}: gain {missing[0]!r} is missing; needed are {', '.join(known)}")
        self.gains: dict[str, Floats] = {key: np.asarray(value, dtype=float) for key, value in gains.items()}
        self._given = self.gains
        #: Gains that were found on the paper's rig and are carried over, by name.
        self.carried: frozenset[str] = frozenset()
        self.scales, self.rig = PAPER, PAPER
        self._sets: dict[float, dict[str, Floats]] = {}
        self.period = 0.0
        self.guard = InputGuard(0, 1.0)
        self._started = False

    def for_periods(self, sets: Mapping[float, Mapping[str, Any]]) -> None:
        """Gains for control periods (s): `reset` takes those whose period is nearest in ratio to its own."""
        self._sets = {float(p): type(self)(self.name, **each).gains for p, each in sets.items()}

    def carry(self) -> Self:
        """The same controller; its gains were found on the paper's rig."""
        self.carried = frozenset(self._given)
        return self

    def with_gains(self, /, **changed: Any) -> "Controller":
        """The same controller with single gains changed, at whatever control period."""
        again = type(self)(self.name, **{**self._given, **changed})
        again.plant, again.carried = self.plant, self.carried - changed.keys()
        again.for_periods({period: {**each, **changed} for period, each in self._sets.items()})
        return again

    def drives(self, model: "PlantModel") -> None:
        """Called before `reset` with the model of the rig as its owner has it: before valves are drawn."""
        self.rig = scales_of(model)
        self.scales = self.units_for(model) if self.similar else PAPER

    def units_for(self, model: "PlantModel") -> Scales:
        """How large a rig is beside the paper's in the units of a law that is `similar`."""
        return scales_of(model)

    def gains_given(self) -> Mapping[str, Floats]:
        """The gains for the control period, in their own units."""
        sets = self._sets or {self.period: self._given}
        return sets[min(sets, key=lambda known: abs(log(known / self.period)))]

    def converted(self, gains: Mapping[str, Floats]) -> dict[str, Floats]:
        """Gains in the units in which the law works."""
        size = {gain.name: gain.size(self.scales) for gain in self.GAINS} | dict.fromkeys(self.carried, 1.0)
        return {name: value / size[name] for name, value in gains.items()}

    def prepare(self, plant: "Plant") -> None:
        """Called with the rigs (rows of `plant`) before the episode, where `needs` asks for it."""

    def foresee(self, load: Floats) -> None:
        """Called with the loads of the episode, (rows, num_rigs, 2) in N m, row n in force from n periods on, where `needs`
        is "everything".
        """

    def reset(self, num_rigs: int, control_period: float) -> None:
        """Forgets the last episode. `control_period` in s."""
        self.period, self._started = float(control_period), False
        self.guard = InputGuard(int(num_rigs), self.period)
        self.gains = self.converted(self.gains_given())

    @guarded
    def act(self, observation: Reals) -> Floats:
        """Commands (num_rigs, 2) in [-1, 1] for observations (num_rigs, n) as the environment gives them."""
        measured = decode(np.asarray(observation), self.rig).over(self.scales)
        if not self._started:
            self.sent = np.clip(measured.command, -1.0, 1.0).astype(float)
            self.__shaper = InputShaper(SPOOL_RATE, self.period, self.sent)
            self.start(measured)
            self._started = True
        else:
            self.take_in(measured)
        per_volt = FRACTION_PER_V / (1.0 if self.similar else self.rig.command)
        most = self.gains.get("slew", inf) * per_volt * self.period
        largest, rate = self.allowed
        if rate < inf:
            most = np.minimum(most, rate * self.period)
        last = self.__shaper.past[-1]
        self.limits = np.maximum(last - most, -largest), np.minimum(last + most, largest)
        self.asked = self.command(measured)
        low, high = self.limits
        # `np.clip` does the same in three times the time.
        limited = np.minimum(np.maximum(self.asked, low), high)
        smooth = self.__shaper.step(limited)
        share = self.gains.get("shape", 0.0)
        self.sent = np.minimum(np.maximum(limited + share * (smooth - limited), -1.0), 1.0)
        return self.sent

    def start(self, measured: Measurements) -> None:
        """Sets the inner state from the first measurement, so that taking over causes no bump."""

    def take_in(self, measured: Measurements) -> None:
        """Takes in a measurement after the first one, before `command`."""

    def command(self, measured: Measurements) -> Floats:
        """Commands (num_rigs, 2) as a fraction of the rated command; may exceed [-1, 1], `act` limits them."""
        raise NotImplementedError
