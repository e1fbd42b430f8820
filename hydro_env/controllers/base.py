"""What a controller is: gains with names and units, `reset`, `act` on observations, one row per rig."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from hydro_env.envs.observation import Measurements, decode
from hydro_env.errors import InputError
from hydro_env.plant import PARAMETERS
from hydro_env.units import RPM

if TYPE_CHECKING:
    from hydro_env.plant import Plant

__all__ = ["FRACTION_PER_V", "RPM", "Controller", "Floats", "Gain", "Measurements"]

Floats = NDArray[np.float64]

FRACTION_PER_V = 1.0 / PARAMETERS["u_rated"].nominal
"""One volt of command as a fraction of the rated command."""


@dataclass(frozen=True)
class Gain:
    """A number of a controller that may be tuned: its unit, the range a tuner searches, and on what scale."""

    name: str
    unit: str
    low: float
    high: float
    log: bool = True
    summary: str = ""


class Controller:
    """Drives both valves of every rig of a batch from what can be measured there.

    Subclasses list their gains in `GAINS` and implement `start` and `command`; anything else with a `reset`
    and an `act` of the same meaning can be benchmarked as well. A gain may be a number, an array (2,) with
    a value per channel, or an array (num_rigs, 1) with a value per rig; the latter is how a tuner tries
    many at once.

    Class attributes:
        GAINS: the gains the constructor takes, by name.
        needs: "measurements" for a controller that knows nothing of the drawn valves; "bench" for one that
            had each pair on a valve bench beforehand, "parameters" for one that is told the truth about the
            valves, "everything" for one that is told the loads to come as well. All but the first get `prepare`
            called with a copy of the plant, the last one `foresee` too. Score boards name what a controller needs.
        plant: the plant the controller belongs to where that is another one than the plant under test.
    """

    GAINS: ClassVar[tuple[Gain, ...]] = ()
    needs: str = "measurements"
    plant: str | None = None

    def __init__(self, name: str | None = None, **gains: Any) -> None:
        self.name = name or type(self).__name__
        known = [gain.name for gain in self.GAINS]
        wrong = sorted(set(gains) ^ set(known))
        if wrong:
            raise InputError(
                f"{self.name}: gain {wrong[0]!r} is missing or unknown; needed are {', '.join(known)}"
            )
        self.gains: dict[str, Floats] = {key: np.asarray(value, dtype=float) for key, value in gains.items()}
        self.period = 0.0
        self._started = False
        self._num_rigs = 0

    def prepare(self, plant: Plant) -> None:
        """Gets to know the rigs (rows of `plant`) before the episode; only where `needs` asks for it."""

    def foresee(self, load: Floats) -> None:
        """Gets to know the loads of the episode, (rows, num_rigs, 2) in N m, row n in force from n periods on; only
        where `needs` is "everything".
        """

    def reset(self, num_rigs: int, control_period: float) -> None:
        """Forgets the last episode. `control_period` in s."""
        self.period, self._num_rigs, self._started = float(control_period), int(num_rigs), False

    def act(self, observation: NDArray[np.floating[Any]]) -> Floats:
        """Commands (num_rigs, 2) in [-1, 1] for observations (num_rigs, n) as the environment gives them."""
        measured = decode(np.asarray(observation))
        if measured.speed.shape != (self._num_rigs, 2):
            raise ValueError(
                f"{self.name} was reset for {self._num_rigs} rigs, got {len(measured.speed)} observations"
            )
        if not self._started:
            self.start(measured)
            self._started = True
        return np.clip(self.command(measured), -1.0, 1.0)

    def start(self, measured: Measurements) -> None:
        """Sets the inner state from the first measurement, so that taking over causes no bump."""

    def command(self, measured: Measurements) -> Floats:
        """Commands (num_rigs, 2) as a fraction of the rated command; may exceed [-1, 1], `act` limits them."""
        raise NotImplementedError
