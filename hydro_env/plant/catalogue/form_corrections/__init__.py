"""Corrections of form: bends, curves and second elements at the port of a named effect, which are no physics.

The law of an effect in the catalogue is one form of many that a real valve or motor may have: a corner is rounded, a gain is
no straight line, a lag has a second pole. What a form leaves can be put right by a correction with a few numbers once the
effect itself has a name. The corrections here are such: rounded corners, curves by straight lines between fixed knots, more
elements of the same kind, more terms of a series. Each is an effect like any other, described once and simulated by the
same kernel, exactly absent at its neutral value; so a model file can carry it. None is a candidate of the
diagnosis and none ever explains anything by itself.

They belong to the family `shape` and are no part of `BUILT_IN`: the reference simulator does not know them.
"""

from collections.abc import Mapping

from . import motor, valve
from .correction import FAMILY

__all__ = ["CORRECTIONS", "EFFECTS", "FAMILY", "follows"]

#: In the order in which they act.
EFFECTS = (*valve.EFFECTS, *motor.EFFECTS)

#: Corrections that fit an effect, by the effect's name; see `Effect.corrects` for what belongs to each.
CORRECTIONS: dict[str, dict[str, Mapping[str, str | float]]] = {}
for _effect in EFFECTS:
    for _corrected, _repeats in _effect.corrects.items():
        CORRECTIONS.setdefault(_corrected, {})[_effect.name] = _repeats


def follows(correction: str, effect: str) -> dict[str, str | float]:
    """The parameters of a correction that are not its own: by full name the full name (with a minus where they repeat
    its opposite), or the number, that they repeat."""
    found: dict[str, str | float] = {}
    for own, source in CORRECTIONS[effect][correction].items():
        if isinstance(source, str):
            source = f"-{effect}.{source[1:]}" if source.startswith("-") else f"{effect}.{source}"
        found[f"{correction}.{own}"] = source
    return found
