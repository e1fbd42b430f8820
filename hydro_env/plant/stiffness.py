"""How finely a channel has to be stepped, from its parameters alone.

The spool is what limits the substep of h seconds; the method damps coil, pressure and shaft, but for a ring of the motor against
its line that hardly anything damps (`ring_parts`). With its greatest force F and
mass m it gains the speed a h in a substep, a = 2 F / m. Five ratios say what a substep resolves:

    stretch    h s1 / m                             damping of the bristles against the mass
    contact    h sqrt(k_stop / m)                   natural frequency at an end stop
    blow       h sqrt(k_stop (1 + v / v_stop) / m)  the same at the blow, v = sqrt(F x_max / m)
    turn       a h^2 / g                            how often a spool that turns moves its bristles by their travel g = Fc / s0
    coupled    stretch * turn                       the same with damped bristles

The last one falls with the third power of h; it grows where static friction is more than four times the Coulomb friction, to
which it has to fall. Where a hysteresis follows the current, the coil counts too, with h R / L. Each has to stay below a
bound. The bounds were measured on models that lie far apart (`python -m hydro_env.experiments.accuracy`). Where one is passed,
the channel takes every substep in 2, 4, 16 or 64 parts.
"""

from __future__ import annotations

from collections.abc import Mapping

from .vector_math import sqrt

__all__ = [
    "FINE_PARTS",
    "LAWS",
    "LINE",
    "LEAST_FRICTION",
    "MOST_FINER",
    "MOST_PEAK",
    "SPOOL",
    "greatest_force",
    "parts_wanted",
]

#: Numbers of parts in which a stiff channel takes every substep.
FINE_PARTS = (2, 4, 16, 64)
#: In how many again a stiff channel takes the parts at a bend of an effect, at most.
MOST_FINER = 16.0
#: Dry friction of the spool, N, below which the bristles are as much softer: they yield at the same travel then, so that no
#: substep has to be shorter. And how many times one of both may be the other below that.
LEAST_FRICTION, MOST_PEAK = 0.001, 20.0
#: Base parameters that decide.
SPOOL = ("m", "R", "alpha", "k", "Fc", "Fs", "s0", "s1", "x_max", "k_stop", "v_stop", "u_rated")
#: The same of motor and line.
LINE = ("D", "J", "B", "Km", "beta", "V")


def greatest_force(alpha, R, k, x_max, u_rated):
    """The greatest force on the spool, N: of the coil or the spring. No limit of the command counts as 300 V."""
    pull = alpha * (u_rated if u_rated < 300.0 else 300.0) / R
    spring = k * x_max
    return pull if pull > spring else spring


def bristle_parts(substep, force, m, Fc, Fs, s0, s1):
    """The third power of the number of parts in which the bristles want a substep (s)."""
    friction = Fc if Fc < Fs else Fs
    drop = Fs / (4.0 * Fc)
    stretch = substep * s1 / m
    turn = substep * substep * 2.0 * force * s0 / (m * friction)
    coupled = turn * stretch * (drop if drop > 1.0 else 1.0)
    coupled = coupled / 0.55
    stretch = stretch / 0.65
    turn = turn / 6.0
    cubed = stretch * stretch * stretch
    cubed = cubed if cubed > coupled else coupled
    turned = turn * sqrt(turn)
    return cubed if cubed > turned else turned


def stop_parts(substep, force, m, x_max, k_stop, v_stop):
    """The same for the end stops."""
    contact = substep * sqrt(k_stop / m)
    blow = contact * sqrt(1.0 + sqrt(force * x_max / m) / v_stop)
    contact = contact / 0.6
    blow = blow / 3.0
    most = blow if blow > contact else contact
    return most * most * most


def coil_parts(substep, R, L):
    """The same for the coil, where an effect follows the rate of the current."""
    ratio = substep * R / (0.35 * L)
    return ratio * ratio * ratio


def ring_parts(substep, D, J, B, Km, beta, V):
    """The same for a motor that rings against its line.

    The phase is off by the third power of the turn in a substep, and more with every turn as long as the ring lasts, of which ten
    seconds count. No spool excites a ring of more than half a radian in a substep.
    """
    rate = D * sqrt(beta / (V * J))
    turn = substep * rate
    lasts = 2.0 * rate / (Km * beta / V + B / J + 0.2)
    return turn * turn * turn * lasts / 0.005 if turn < 0.5 else 0.0


def fine_parts(bristles, stops, coil, ring):
    """In how many parts a channel takes every substep: 1, 2, 4, 16 or 64, with a reserve of a third and more."""
    cubed = stops if stops > bristles else bristles
    cubed = coil if coil > cubed else cubed
    cubed = ring if ring > cubed else cubed
    parts = 16.0 if cubed <= 1e3 else 64.0
    parts = 4.0 if cubed <= 27.0 else parts
    parts = 2.0 if cubed <= 3.375 else parts
    return 1.0 if cubed <= 1.0 else parts


def corner_parts(parts, least):
    """In how many parts a substep is taken at a bend that asks for `parts`, where its stiffness wants `least` of them."""
    more = 4.0 if least <= 4.0 * parts else 16.0
    return parts if least <= parts else more * parts


def friction_left(friction, other):
    """What is left of Fc or Fs (N) when effects have added to it or taken from it; 1 N that acts on nothing if none is.

    No less than `LEAST_FRICTION`, or than the other one over `MOST_PEAK` where that is less.
    """
    least = other / 20.0 if other < 0.02 else 0.001
    least = least if least > friction else friction
    return least if least > 0.0 else 1.0


def bristles_left(Fc, Fs):
    """By which factor the bristles are softer than s0 and s1 say, with what is left of the friction."""
    friction = Fc if Fc < Fs else Fs
    return friction / 0.001 if friction < 0.001 else 1.0


#: What the kernel takes from here.
LAWS = (
    greatest_force,
    bristle_parts,
    stop_parts,
    coil_parts,
    ring_parts,
    fine_parts,
    corner_parts,
    friction_left,
    bristles_left,
)


def parts_wanted(substep: float, values: Mapping[str, float]) -> float:
    """Into how many parts a substep (s) should be divided for a spool with these values of `SPOOL`, less than one included."""
    v = values
    force = greatest_force(v["alpha"], v["R"], v["k"], v["x_max"], v["u_rated"])
    bristles = bristle_parts(substep, force, v["m"], v["Fc"], v["Fs"], v["s0"], v["s1"])
    stops = stop_parts(substep, force, v["m"], v["x_max"], v["k_stop"], v["v_stop"])
    return float(max(bristles, stops) ** (1.0 / 3.0))
