"""How long logs must be, so that something is tested by them.

A run is worth as many independent pieces as it has stretches that are longer than the rig's memory: the shaft with its leakage
forgets its speed with J / (B + D^2 / Km), 0.18 s on the preset rigs, and what two stretches hold is independent from twice
that on. The uncertainty of all results is a bootstrap over these stretches. With n of them there are C(2n - 1, n) different
replicas (Efron and Tibshirani, An Introduction to the Bootstrap, 1993, section 6.2); a 95 % interval needs at least forty, one
beyond each end. With fewer stretches nothing can be told from chance, and the verdict would be `none` whatever the rig lacks.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import comb

from ...errors import InputError
from .parts import Part

__all__ = ["SHORTEST_S", "STRETCH_S", "check_duration"]

#: Length of a stretch, s.
STRETCH_S = 0.5
#: Chance that a value lies beyond one end of a 95 % interval.
_TAIL = 0.025
#: The fit logs, and the held-out ones, last at least so long in all, s.
SHORTEST_S = STRETCH_S * next(n for n in range(1, 100) if comb(2 * n - 1, n) >= 1.0 / _TAIL)


def check_duration(parts: Sequence[Part], what: str) -> None:
    """InputError if logs, `what` they are ("fit", "held-out"), are too short in all."""
    lasts = sum(part.seconds for part in parts)
    if lasts < (1.0 - 1e-6) * SHORTEST_S:
        logs = ", ".join(part.label for part in parts)
        raise InputError(
            f"{logs}: the {what} logs last {lasts:.2g} s in all, at least {SHORTEST_S:g} s are needed: "
            f"{SHORTEST_S / STRETCH_S:.0f} stretches of {STRETCH_S:g} s, each longer than the rig's memory, are the fewest that "
            "give a 95 % interval; record longer, 10 s or more is good"
        )
