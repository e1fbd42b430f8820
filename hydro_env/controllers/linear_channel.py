"""The base equations of a channel, linearised."""

from collections.abc import Callable

import numpy as np

from hydro_env.arrays import Floats


def linear_rates(value: Callable[[str], Floats]) -> Floats:
    """Rates (..., 5, 5) of current, travel and speed of the spool, pressure and motor speed with each of them, SI: (5), (6), (8),
    (1) and (2), with the valve open and the spool sliding. `value` gives a parameter by its name, (...)."""
    stiffness, mass = value("beta") / value("V"), value("m")
    rates = np.zeros((*mass.shape, 5, 5))
    rates[..., 0, 0], rates[..., 0, 2] = -value("R") / value("L"), -value("alpha") / value("L")
    rates[..., 1, 2] = 1.0
    rates[..., 2, 0], rates[..., 2, 1] = value("alpha") / mass, -value("k") / mass
    rates[..., 2, 2] = -(value("C") + value("s2")) / mass
    rates[..., 3, 1], rates[..., 3, 3] = stiffness * value("Kq"), -stiffness * value("Km")
    rates[..., 3, 4] = -stiffness * value("D")
    rates[..., 4, 3], rates[..., 4, 4] = value("D") / value("J"), -value("B") / value("J")
    return rates
