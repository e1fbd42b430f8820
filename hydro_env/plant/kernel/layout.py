"""Where everything lies in the memory of a block: states, parameters, stages, and what is computed once.

A block is `half` rigs side by side; lanes 0..half-1 are their first channels, lanes half..2*half-1 their second ones. A row
holds one name of all lanes; all rows of a block lie one after the other in a flat array.
"""

from collections.abc import Iterable

from ..catalogue.effect import Effect, State
from ..parameters import PARAMETERS

#: States of a channel, in the order of `rates`.
STATES = ("current", "spool", "spool_speed", "bristle", "pressure", "speed", "angle")
#: A state that nothing acts on but another one, of which it is the integral.
INTEGRAL = {"angle": "speed"}
#: Base parameters that are divided by: their reciprocals are rows of their own, since a division costs ten products.
DIVISORS = ("L", "m", "V", "J", "vs", "v_stop", "beta")
RECIPROCALS = tuple(f"per_{name}" for name in DIVISORS)
_OUTPUTS = (
    "time", "step", "failed", "attempts", "flow", "measured_speed", "mean_line_pressure", "motor_pressure",
    "diverged", "lost_at", "peak_difference", "command", "load",
)  # fmt: skip


def in_text(effect: Effect, own: str) -> str:
    """What a parameter or state of an effect is called in the generated text."""
    return f"{effect.name}__{own}"


def with_shared(effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """The effects, each after what it shares with others, which is there once."""
    both = (one for effect in effects for one in (effect.shares, effect) if one is not None)
    return tuple(dict.fromkeys(both))


def states_of(effects: Iterable[Effect]) -> dict[str, list[tuple[Effect, State]]]:
    """The states of effects by their names in the text, each with all that adds to its rate."""
    found: dict[str, list[tuple[Effect, State]]] = {}
    for effect in effects:
        for state in effect.states:
            shared = effect.shares is not None and state.name in effect.shares.names
            owner = effect.shares if effect.shares is not None and shared else effect
            found.setdefault(in_text(owner, state.name), []).append((effect, state))
    return found


def scale_of(adding: Iterable[tuple[Effect, State]]) -> float:
    """The scale of a state of effects, see `State`."""
    return float(max(state.scale for _, state in adding))


class Layout:
    """Names and rows of a block of `half` rigs. `states` are those of `rates` and of the effects. The first `moving` rows change
    with time, the first `kept` ones stay between calls; a name without a row gets the next one when it is first used.
    """

    def __init__(self, effects: tuple[Effect, ...], half: int) -> None:
        self.effects, self.half, self.parameters = effects, half, parameters_of(effects)
        self.states = STATES + tuple(states_of(effects))
        moving = [*self.states, *_OUTPUTS]
        kept = [*moving, *self.parameters]
        self.rows = {name: row for row, name in enumerate([*kept, "row_left"])}
        self.moving, self.kept = len(moving), len(kept)

    @property
    def staged(self) -> list[str]:
        """States with stages of their own."""
        return [name for name in self.states if name not in INTEGRAL]

    @property
    def own_states(self) -> tuple[str, ...]:
        """States of the effects."""
        return self.states[len(STATES) :]

    def row(self, name: str) -> int:
        """The row of a name."""
        return self.rows.setdefault(name, len(self.rows))

    def cell(self, name: str) -> str:
        """The cell of a name on lane `l`."""
        return f"cells[{self.row(name) * 2 * self.half} + l]"


def parameters_of(effects: Iterable[Effect]) -> tuple[str, ...]:
    """The parameters of a channel with these effects."""
    return (*PARAMETERS, *(in_text(e, p.name) for e in effects for p in e.parameters))
