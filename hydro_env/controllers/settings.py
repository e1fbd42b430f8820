"""Settings of a controller's parts: small named tuples, which compiled code takes as well. Every field has a unit, a meaning and
a reason for its value.

    class ReferenceSettings(NamedTuple):
        rate: Annotated[float, "1/s", "how fast the reference runs to the set-point", TUNED] = 42.0

A truth value has the unit "", and no reason where its meaning says it.
"""

TUNED = "tuned on `train`"
"""Found by an evolution strategy, or by trial, on pairs of the split `train`; docs/evidence/notes.md has the trials."""
HAND = "set by hand"
"""Chosen once, never searched for."""
