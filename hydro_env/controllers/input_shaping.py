"""Input shaping: a filter of three taps that does not excite the spool's lightly damped mode (Singer and Seering,
Preshaping Command Inputs to Reduce System Vibration, J. Dyn. Syst. Meas. Control 112, 1990)."""

from math import cos, pi

import numpy as np

from hydro_env.arrays import Bools, Floats


class InputShaper:
    """The filter for commands (num_rigs, 2), whose `past` values are kept, oldest first."""

    def __init__(self, rate: float, period: float, command: Floats) -> None:
        """For a mode of `rate` 1/s, sampled every `period` s; `command` was in force for long."""
        self.spacing, self.outer = three_taps(rate, period)
        self.past = [command] * (2 * self.spacing)

    def step(self, command: Floats) -> Floats:
        """The filtered command of this sample."""
        ends, middle = command + self.past[0], self.past[self.spacing]
        self.past = [*self.past[1:], command]
        return self.outer * ends + (1.0 - 2.0 * self.outer) * middle

    def replace(self, where: Bools, command: Floats) -> None:
        """Goes on as if `command` had been in force for long `where`, (num_rigs, 1) or (num_rigs, 2)."""
        self.past = [np.where(where, command, each) for each in self.past]


def three_taps(rate: float, period: float) -> tuple[int, float]:
    """Spacing (samples) and outer weight a of the taps a, 1 - 2a, a for a mode of `rate` 1/s, sampled every `period` s.

    The response at the mode's angle per spacing phi is 2 a cos(phi) + 1 - 2a, which a = 1 / (2 (1 - cos phi)) makes zero;
    phi near 120 degrees gives three equal weights. Where sampling is so slow that the mode lies beyond the Nyquist frequency,
    the weights are 1/4, 1/2, 1/4.
    """
    spacing = max(1, round(2.0 * pi / 3.0 / rate / period))
    phi = min(rate * period * spacing, pi)
    return spacing, min(0.5 / (1.0 - cos(phi)), 0.4)
