"""Input shaping: a filter of three taps that does not excite the spool's lightly damped mode (Singer and Seering,
Preshaping Command Inputs to Reduce System Vibration, J. Dyn. Syst. Meas. Control 112, 1990)."""

from __future__ import annotations

from math import cos, pi

__all__ = ["three_taps"]


def three_taps(rate: float, period: float) -> tuple[int, float]:
    """Spacing (samples) and outer weight a of the taps a, 1 - 2a, a for a mode of `rate` 1/s, sampled every `period` s.

    The response at the mode's angle per spacing phi is 2 a cos(phi) + 1 - 2a, which a = 1 / (2 (1 - cos phi)) makes zero;
    phi near 120 degrees gives three equal weights. Where sampling is so slow that the mode lies beyond the Nyquist frequency,
    the weights are 1/4, 1/2, 1/4.
    """
    spacing = max(1, round(2.0 * pi / 3.0 / rate / period))
    phi = min(rate * period * spacing, pi)
    return spacing, min(0.5 / (1.0 - cos(phi)), 0.4)
