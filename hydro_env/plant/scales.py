"""How large a rig is beside the paper's, and what follows for everything that is usual on such a rig.

Bounds and typical sizes of effects, speeds and loads of scenarios, scales of observations and rewards are written down for the
paper's rig. On another one they are what similarity makes of them: a length at the spool grows with the spool's rated travel,
a torque with displacement times supply pressure, and so on by the unit (Ivantysyn and Ivantysynova 2001, similarity of
displacement machines; Merritt 1967, ch. 5, valves by rated flow). All scales are 1 on the paper's rig.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import inf, log10, prod
from typing import TYPE_CHECKING, Protocol

from ..reading import shipped_yaml
from .parameters import PARAMETERS, SUPPLY_PRESSURE, Parameter

if TYPE_CHECKING:
    from .catalogue import Effect

#: What a unit is a product of, as powers of the fields of `Scales`. A quantity with another unit is the same on every rig.
_DIMENSIONS: Mapping[str, Mapping[str, float]] = shipped_yaml(__package__, "dimensions.yaml")
#: Preferred numbers of a decade.
_R10 = (1.0, 1.25, 1.6, 2.0, 2.5, 3.15, 4.0, 5.0, 6.3, 8.0)
#: Fields of `Scales` that each valve has of its own.
_OF_VALVE = ("command", "current", "force", "travel")


@dataclass(frozen=True)
class Scales:
    """Quantities of a channel as multiples of the paper's: rated command (V), current, force and travel of the spool at it, flow
    through the fully open valve, displacement and inertia of the motor, supply pressure."""

    command: float = 1.0
    current: float = 1.0
    force: float = 1.0
    travel: float = 1.0
    flow: float = 1.0
    displacement: float = 1.0
    inertia: float = 1.0
    pressure: float = 1.0

    @property
    def speed(self) -> float:
        """Scale of speeds of the shaft."""
        return self.factor("rad/s")

    @property
    def torque(self) -> float:
        """Scale of torques on the shaft."""
        return self.factor("N m")

    @property
    def rough(self) -> "Scales":
        """The same, with what is about as large as on the paper's rig taken as equal: within a quarter of a decade."""
        own = {name: 1.0 if 10**-0.25 < value < 10**0.25 else value for name, value in vars(self).items()}
        return Scales(**(own | {"command": self.command}))

    def factor(self, unit: str) -> float:
        """Scale of a quantity with this unit."""
        powers = _DIMENSIONS.get(unit, {}).items()
        return prod((getattr(self, name) ** power for name, power in powers), start=1.0)

    def parameter(self, p: Parameter) -> Parameter:
        """A parameter with the bounds and sizes that are usual on this rig; `p` itself where they are the same."""
        factor = 1.0 if p.absolute else self.factor(p.unit) / self.factor(p.per)
        if factor == 1.0:
            return p
        low, nominal, high, typical = (factor * x for x in (p.low, p.nominal, p.high, p.typical))
        least, most = p.possible
        return replace(
            p, low=low, nominal=nominal, high=high, typical=typical, starts=tuple(factor * x for x in p.starts),
            possible=(min(least, factor * least), max(most, factor * most)),
        )  # fmt: skip

    def effect(self, effect: "Effect") -> "Effect":
        """An effect with the bounds and sizes that are usual on this rig; `effect` itself where they are the same."""
        own = tuple(map(self.parameter, effect.parameters))
        same = all(a is b for a, b in zip(own, effect.parameters, strict=True))
        return effect if same else replace(effect, parameters=own)


#: Those of the paper's rig.
PAPER = Scales()


class Rig(Protocol):
    """What has values, as a model has."""

    def value(self, name: str, channel: int, /) -> float: ...


def scales_of(model: Rig, channel: int | None = None) -> Scales:
    """The scales of a model: those of the valve of channel 0 or 1, of the larger one for None; flow, motor and supply are the
    rig's, for which the larger channel counts.

    All but that of the command are preferred numbers (ISO 3, R10): they say how large a machine is, not how two of a kind differ,
    and a model that has been calibrated has the scales that it had before.
    """
    both = [rated(model, c) for c in (0, 1)]
    found = {}
    for name, one in _RATED.items():
        pair = [each[name] / one for each in both]
        ratio = max(pair) if channel is None or name not in _OF_VALVE else pair[channel]
        found[name] = ratio if 0.0 < ratio < inf else 1.0  # a value that is refused says nothing
    command = found.pop("command")
    return Scales(command, **{name: _preferred(ratio) for name, ratio in found.items()})


def _preferred(ratio: float) -> float:
    """The nearest preferred number."""
    decade, place = divmod(round(10.0 * log10(ratio)), 10)
    return float(f"{_R10[place]}e{decade}")


def rated(model: Rig, channel: int) -> dict[str, float]:
    """What a channel has at its rated command, by the names of `Scales`, SI."""
    return _rated(lambda name: model.value(name, channel))


def swing(model: Rig, channel: int) -> tuple[float, float]:
    """How a motor swings on the oil of its lines while the valve holds: the square of its frequency, (rad/s)2, and how fast that
    decays, 1/s (Merritt 1967, ch. 6). It swings where the decay is less than twice the frequency."""
    D, J, B, Km, V, beta = (model.value(name, channel) for name in ("D", "J", "B", "Km", "V", "beta"))
    return D**2 * beta / (V * J), Km * beta / V + B / J


def _rated(value: Callable[[str], float]) -> dict[str, float]:
    command, current = value("u_rated"), value("u_rated") / (value("R") or inf)
    travel = min(value("alpha") * current / (value("k") or inf), value("x_max"))
    supply = value("pressure_dependent_flow.supply_pressure")
    return {
        "command": command,
        "current": current,
        "force": value("k") * travel,
        "travel": travel,
        "flow": value("Kq") * travel,
        "displacement": value("D"),
        "inertia": value("J"),
        "pressure": supply if 0.0 < supply < inf else SUPPLY_PRESSURE.nominal,
    }


_RATED = _rated(lambda name: PARAMETERS[name].nominal if name in PARAMETERS else inf)
