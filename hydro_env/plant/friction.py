"""The dry friction of a spool that is left when effects have added to it or taken from it."""

#: Dry friction of the spool, N, below which the bristles are as much softer: they yield at the same travel then. And how many
#: times one of both may be the other below that.
MIN_FRICTION, MAX_PEAK = 0.001, 20.0


def friction_left(friction, other):
    """What is left of Fc or Fs (N) when effects have added to it or taken from it; 1 N that acts on nothing if none is.

    No less than `MIN_FRICTION`, or than the other one over `MAX_PEAK` where that is less.
    """
    least = other / 20.0 if other < 0.02 else 0.001
    least = least if least > friction else friction
    return least if least > 0.0 else 1.0


def bristles_left(Fc, Fs):
    """By which factor the bristles are softer than s0 and s1 say, with what is left of the friction."""
    friction = Fc if Fc < Fs else Fs
    return friction / 0.001 if friction < 0.001 else 1.0
