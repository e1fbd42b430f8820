"""The integrator's tableau: a linearly implicit (Rosenbrock) W-method of three stages, of which two share their rates.

J. Rang, L. Angermann, New Rosenbrock W-methods of order 3 for partial differential algebraic equations of index 1, BIT
Numerical Mathematics 45, 2005, 761-787: the family of ROS3w, L-stable, of order 3 with the Jacobian as the matrix W, and of
order 2 with *any* matrix. The transformation that needs no product with the matrix is that of Hairer and Wanner, Solving
Ordinary Differential Equations II, section IV.7.

A step of h from y solves, for the stages i = 0..2,

    (1 / (gamma h) - W) u_i = f(y + sum over j < i of a[i, j] u_j) + sum over j < i of c[i, j] / h u_j

and ends at y + sum of m[i] u_i. Stages 1 and 2 stand at the same place, so their rates are the same.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["METHOD", "Rosenbrock", "integral_coefficients"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Rosenbrock:
    """A tableau: `gamma`, `alpha` (s, s), `Gamma` (s, s) and `b` (s,) as published, and what the transformed method uses:
    `a` (s, s), `c` (s, s), `m` (s,).
    """

    gamma: float
    alpha: Array
    Gamma: Array
    b: Array

    @property
    def a(self) -> Array:
        return self.alpha @ np.linalg.inv(self.Gamma)

    @property
    def c(self) -> Array:
        return np.eye(len(self.b)) / self.gamma - np.linalg.inv(self.Gamma)

    @property
    def m(self) -> Array:
        return self.b @ np.linalg.inv(self.Gamma)


def _ros3w(free: float) -> Rosenbrock:
    """The method of the family whose second stage has the matrix in it with the factor `free`; ROS3w has 0.3635."""
    gamma = 4.3586652150845900e-01  # of gamma^3 - 3 gamma^2 + 3/2 gamma = 1/6, by which it is L-stable
    place, b = 2.0 / 3.0, np.array([0.25, 0.25, 0.5])
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


#: From -0.1 to -0.3 the speeds of the presets are off by about the same, with the 0.3635 of ROS3w by up to twice that.
METHOD = _ros3w(-0.2)


def integral_coefficients(method: Rosenbrock) -> tuple[Array, Array]:
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
