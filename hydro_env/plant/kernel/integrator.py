"""The integrator as data: its tableau, its estimate of the error, what an error counts, and the control of the step.

Method. ROS3w, a linearly implicit (Rosenbrock) W-method of three stages, of which two share their rates; L-stable, of order 3
with the Jacobian as the matrix W and of order 2 with *any* matrix. J. Rang, L. Angermann, New Rosenbrock W-methods of order 3 for
partial differential algebraic equations of index 1, BIT Numerical Mathematics 45, 2005, 761-787. The transformation that needs
no product with the matrix is that of E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, section IV.7. A step of h
from y solves, for the stages i = 0..2,

    (1 / (gamma h) - W) u_i = f(y + sum over j < i of a[i, j] u_j) + sum over j < i of c[i, j] / h u_j

and ends at y + sum of m[i] u_i. Stages 1 and 2 stand at the same place, so their rates are the same.

Error. The defect of the trapezoidal rule over the step, filtered by the matrix that the stages have factored (Hairer and Wanner,
section IV.8):

    e = 1 / gamma (1 / (gamma h) - W)^-1 ((y1 - y) / h - (f(y) + f(y1)) / 2)

It costs no rates of its own, as f(y1) begins the next step, and it sees what a step ran into at its end: a stop, a bend, a spool
that sticks. E is the sum of (e / weight)^2, with the weights of `ERRORS`.

Step. It is taken if E <= 1, else tried again; the next one is 0.9 E^(-1/6) times as long, at least three tenths and at most four
times (section IV.2), rounded down to one of a ladder of factors.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hydro_env.arrays import Floats


@dataclass(frozen=True)
class Rosenbrock:
    """A tableau: `gamma`, `alpha` (s, s), `Gamma` (s, s) and `b` (s,) as published, and what the transformed method uses:
    `a` (s, s), `c` (s, s), `m` (s,).
    """

    gamma: float
    alpha: Floats
    Gamma: Floats
    b: Floats

    @property
    def a(self) -> Floats:
        return self.alpha @ np.linalg.inv(self.Gamma)

    @property
    def c(self) -> Floats:
        return np.eye(len(self.b)) / self.gamma - np.linalg.inv(self.Gamma)

    @property
    def m(self) -> Floats:
        return self.b @ np.linalg.inv(self.Gamma)


def _ros3w() -> Rosenbrock:
    gamma = 4.3586652150845900e-01  # of gamma^3 - 3 gamma^2 + 3/2 gamma = 1/6, by which it is L-stable
    place, free, b = 2.0 / 3.0, 3.635068368900681e-01, np.array([0.25, 0.25, 0.5])
    # The sums of alpha and Gamma that remain to be chosen for order 3.
    second = place + free
    third = ((0.5 - gamma) - b[1] * second) / b[2]
    between = (1.0 / 6.0 - gamma + gamma**2) / (b[2] * second)
    return Rosenbrock(
        gamma=gamma,
        alpha=np.array([[0.0, 0.0, 0.0], [place, 0.0, 0.0], [place, 0.0, 0.0]]),
        Gamma=np.array([[gamma, 0.0, 0.0], [free, gamma, 0.0], [third - between - place, between, gamma]]),
        b=b,
    )


METHOD = _ros3w()

#: The weights: the error of a state that counts as one, from the tolerance of the speed (rad/s) and parameters. That of the
#: pressure is the speed that its energy would give the shaft (a softer fluid makes it less, by the root of its bulk modulus over
#: beta); the others go by the steady speed that a displacement of the spool is worth: a current by its force against the spring,
#: a spool speed by the way it makes in the time of the spool's own oscillation. The factors were chosen together on the presets,
#: for the fewest steps that keep speeds within the tolerance: a spool that sticks keeps its error, a speed forgets it.
ERRORS = {
    "current": "5.0 * tolerance * D * k / (Kq * alpha)",
    "spool": "0.011 * tolerance * D / Kq",
    "spool_speed": "3.0 * tolerance * D / Kq * sqrt(k / m)",
    "bristle": "0.5 * tolerance * D / Kq",
    "pressure": "0.1 * tolerance * sqrt(J / V * beta)",
    "speed": "0.006 * tolerance",
}


class Tolerated(NamedTuple):
    """What the tolerance of the speed allows. It is at most `share` of the speed that the fully open valve gives the motor, down
    to `min_share` of itself. For each rad/s of it a spool in motion may be `late`, in s: its weight grows with its speed.
    The same of a state of an effect: `own_error` of its size for each rad/s, and `own_late`, s."""

    share: float = 3e-4
    min_share: float = 0.01
    late: float = 1.8e-4
    own_error: float = 0.025
    own_late: float = 1.8e-4


TOLERATED = Tolerated()


@dataclass(frozen=True)
class Control:
    """How the next step follows from E: `ladder` has (E, factor), the factor from there on, 0.9 E^(-1/6) by steps. After a reset
    a step is `first` s; what fails at `smallest` s cannot be followed. With dry friction a step is at most
    `sticking` radians of the swing that a stuck spool has on its bristles and spring. Longer ones make more of a speed that is
    all but zero, as the bristles yield to one side only, and the spool creeps for as long as the command is held."""

    ladder: tuple[tuple[float, float], ...] = (
        (0.0, 4.0), (1e-4, 2.8), (1e-3, 2.0), (0.01, 1.6), (0.04, 1.3), (0.15, 1.1), (0.4, 0.97), (0.7, 0.9),
        (1.0, 0.8), (3.0, 0.65), (10.0, 0.5), (50.0, 0.4), (400.0, 0.3),
    )  # fmt: skip
    first: float = 1e-4
    smallest: float = 1e-10
    sticking: float = 0.7


CONTROL = Control()


def integral_coefficients(method: Rosenbrock) -> tuple[Floats, Floats]:
    """What the method makes of a state whose rate is another state v, in closed form.

    Such a state needs no stages of its own: at stage i (row 3: at the end of the step) it is
    y + h (p[i] v + sum over j of q[i, j] u_j), with u_j the stages of v. Returns p (4,) and q (4, 3).
    """
    a, c, gamma = np.vstack([method.a, method.m]), method.c, method.gamma
    own, stages = np.zeros(3), np.zeros((3, 3))  # its stages w_i = h (own[i] v + sum of stages[i, j] u_j)
    for i in range(3):
        own[i] = gamma * (1.0 + c[i, :i] @ own[:i])
        stages[i] = gamma * (a[i] + np.eye(3)[i] + c[i, :i] @ stages[:i])
    return a @ own, a @ stages
