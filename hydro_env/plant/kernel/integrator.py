"""The integrator's tableau: ROS34PW2, a linearly implicit (Rosenbrock) W-method.

J. Rang, L. Angermann, New Rosenbrock W-methods of order 3 for partial differential algebraic equations of index 1, BIT
Numerical Mathematics 45, 2005, 761-787: four stages, order 3, L-stable, stiffly accurate, and of full order with *any*
matrix W in place of the Jacobian. The transformation that needs no product with the matrix is that of Hairer and Wanner,
Solving Ordinary Differential Equations II, section IV.7.

A step of h from y solves, for the stages i = 0..3,

    (1 / (gamma h) - W) u_i = f(y + sum over j < i of a[i, j] u_j) + sum over j < i of c[i, j] / h u_j

and ends at y + sum of m[i] u_i. The method is stiffly accurate: the end is where the last stage stands, plus its u.
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


_GAMMA = 4.3586652150845900e-01

#: ROS34PW2.
METHOD = Rosenbrock(
    gamma=_GAMMA,
    alpha=np.array([
        [0.0, 0.0, 0.0, 0.0],
        [8.7173304301691801e-01, 0.0, 0.0, 0.0],
        [8.4457060015369423e-01, -1.1299064236484185e-01, 0.0, 0.0],
        [0.0, 0.0, 1.0, 0.0],
    ]),
    Gamma=np.array([
        [_GAMMA, 0.0, 0.0, 0.0],
        [-8.7173304301691801e-01, _GAMMA, 0.0, 0.0],
        [-9.0338057013044082e-01, 5.4180672388095326e-02, _GAMMA, 0.0],
        [2.4212380706095346e-01, -1.2232505839045147e00, 5.4526025533510214e-01, _GAMMA],
    ]),
    b=np.array([2.4212380706095346e-01, -1.2232505839045147e00, 1.5452602553351020e00, 4.3586652150845900e-01]),
)  # fmt: skip


def integral_coefficients(method: Rosenbrock) -> tuple[Array, Array]:
    """What the method makes of a state whose rate is another state v, in closed form.

    Such a state needs no stages of its own: at stage i (row 4: at the end of the step) it is
    y + h (p[i] v + sum over j of q[i, j] u_j), with u_j the stages of v. Returns p (5,) and q (5, 4).
    """
    a, c, gamma = np.vstack([method.a, method.m]), method.c, method.gamma
    own, stages = np.zeros(4), np.zeros((4, 4))  # its stages w_i = h (own[i] v + sum of stages[i, j] u_j)
    for i in range(4):
        own[i] = gamma * (1.0 + c[i, :i] @ own[:i])
        stages[i] = gamma * (a[i] + np.eye(4)[i] + c[i, :i] @ stages[:i])
    return a @ own, a @ stages
