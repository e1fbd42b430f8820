"""What a slider of an effect stands for: whole positions, with the neutral value at 0, and the values of the catalogue there."""

from dataclasses import dataclass, replace
from math import inf, isinf

from hydro_env.lab.rig import effects_offered
from hydro_env.plant import CATALOGUE, Parameter, Scales
from hydro_env.plant.catalogue import PORTS, Effect
from hydro_env.units import BAR, MICROMETRE, MILLISECOND, RPM, with_unit

#: Positions on one side of the neutral value.
POSITIONS = 100

#: Units that are read more easily than SI, by the SI unit and the largest value of the parameter.
_READABLE = {
    "Pa": ("bar", BAR, inf),
    "m": ("µm", MICROMETRE, 0.1),
    "s": ("ms", MILLISECOND, 0.5),
    "rad/s": ("rpm", RPM, inf),
}


@dataclass(frozen=True)
class Slider:
    """A parameter of an effect on one channel (0, 1), or on the whole rig (None).

    Positions are whole numbers from `lowest` to `highest`. 0 is the neutral value. From there to an end the value goes evenly, or
    by equal factors where the catalogue varies the parameter so, to the bound of the catalogue. Where the neutral value lies
    outside of the bounds, as that of a limit does, positions 1 to `POSITIONS` are the whole range, from weak to strong.
    """

    effect: str
    parameter: Parameter
    channel: int | None

    @property
    def name(self) -> str:
        """The name of the parameter in the plant."""
        return f"{self.effect}.{self.parameter.name}"

    @property
    def lowest(self) -> int:
        """The lowest position."""
        return -POSITIONS if self.parameter.low < self.parameter.neutral < inf else 0

    @property
    def highest(self) -> int:
        """The highest position."""
        return POSITIONS if self.parameter.high > self.parameter.neutral or self._apart else 0

    @property
    def _apart(self) -> bool:
        """Whether the neutral value lies outside of the bounds."""
        return not self.parameter.low <= self.parameter.neutral <= self.parameter.high

    def value(self, position: int) -> float:
        """The value (SI) at a position, which is brought within the ends."""
        p = self.parameter
        position = min(max(position, self.lowest), self.highest)
        if position == 0:
            return p.neutral
        if self._apart:
            # A limit is strong where it is low.
            weak, strong = (p.high, p.low) if isinf(p.neutral) else (p.low, p.high)
            share = (position - 1) / (POSITIONS - 1)
        else:
            weak, strong = p.neutral, p.high if position > 0 else p.low
            share = abs(position) / POSITIONS
        if share == 1.0:
            return strong
        even = not (p.log and weak > 0.0 and strong > 0.0)
        value = weak + share * (strong - weak) if even else weak * (strong / weak) ** share
        return float(round(value)) if p.role == "order" else value

    def position(self, value: float) -> int:
        """The position whose value is nearest to a value (SI)."""
        values = {position: self.value(position) for position in range(self.lowest, self.highest + 1)}
        # Infinity less itself is no number.
        return min(values, key=lambda position: values[position] != value and abs(values[position] - value))

    def text(self, value: float) -> str:
        """The value as an engineer reads it; all values of one parameter have the same unit."""
        if isinf(value):
            return "none"
        p = self.parameter
        unit, size, largest = _READABLE.get(p.unit, (p.unit, 1.0, inf))
        return with_unit(value / size, unit, 3) if p.high < largest else with_unit(value, p.unit, 3)


def sliders(effect: Effect, scales: tuple[Scales, Scales]) -> list[Slider]:
    """The sliders of an effect on a rig of these scales: one for each parameter and channel, or one for both of the rig's."""
    channels: tuple[int | None, ...] = (None,) if effect.scope == "rig" else (0, 1)
    return [
        Slider(effect.name, _possible(scales[channel or 0].parameter(p)), channel)
        for p in effect.parameters
        for channel in channels
    ]


def _possible(p: Parameter) -> Parameter:
    """The parameter within what a model accepts."""
    low, high = p.possible
    return replace(p, low=max(p.low, low), high=min(p.high, high))


def effects_by_port() -> dict[str, list[Effect]]:
    """The effects offered, by port, in the order in which the signal passes them."""
    offered = [CATALOGUE[name] for name in effects_offered()]
    return {port: found for port in PORTS if (found := [e for e in offered if e.port == port])}
