"""The few mathematical functions that laws may use, written so that a compiler can run them on many lanes at once.

The compiled kernel works on blocks of channels with vector instructions. Library versions of `exp` and its kin
would force it back to one lane at a time, so these use only +, -, *, / and comparisons. They are pasted into the
generated kernel and behave the same when called from Python. `sqrt` is an instruction of its own.
"""

from math import floor, sqrt

__all__ = ["bell", "clip", "cos", "exp", "positive", "sign", "sin", "sqrt", "tanh"]


def clip(value, low, high):
    """`value` limited to [low, high]."""
    value = low if value < low else value
    return high if value > high else value


def positive(value):
    """`value`, or 0 where that is more."""
    return value if value > 0.0 else 0.0


def sign(value):
    """-1, 0 or 1."""
    return (1.0 if value > 0.0 else 0.0) - (1.0 if value < 0.0 else 0.0)


def exp(x):
    """e to the power x, for |x| <= 80 (clipped beyond); relative error below 2e-5, below 1e-13 for |x| < 3.

    A polynomial on x/64, squared six times.
    """
    t = clip(x, -80.0, 80.0) * 0.015625
    q = t * t
    y = (1.0 + t) + q * ((0.5 + t * (1.0 / 6.0)) + q * ((1.0 / 24.0 + t * (1.0 / 120.0)) + q * (1.0 / 720.0)))
    y = y * y
    y = y * y
    y = y * y
    y = y * y
    y = y * y
    return y * y


def bell(x):
    """exp(-x^2), absolute error below 2e-6, below 1e-9 for |x| < 1.

    A polynomial for exp(-x^2/8), squared three times: cheaper than `exp`, since nobody needs many digits of the tail.
    """
    s = x * x
    s = s if s < 14.0 else 14.0
    q = s * s
    tail = (1.0 / 98304.0 - s * (1.0 / 3932160.0)) + q * (1.0 / 188743680.0)
    y = ((1.0 - s * 0.125) + q * (1.0 / 128.0 - s * (1.0 / 3072.0))) + q * q * tail
    y = y * y
    y = y * y
    return y * y


def tanh(x):
    """Hyperbolic tangent."""
    e = exp(2.0 * clip(x, -20.0, 20.0))
    return (e - 1.0) / (e + 1.0)


def cos(x):
    """Cosine of an angle in rad, absolute error below 1e-9 for |x| < 1e6."""
    turns = x * 0.15915494309189535
    r = (turns - floor(turns + 0.5)) * 6.283185307179586
    q = r * r
    y = 1.0 / 20922789888000.0 - q * (1.0 / 6402373705728000.0)
    y = -1.0 / 87178291200.0 + q * y
    y = 1.0 / 479001600.0 + q * y
    y = -1.0 / 3628800.0 + q * y
    y = 1.0 / 40320.0 + q * y
    y = -1.0 / 720.0 + q * y
    y = 1.0 / 24.0 + q * y
    return 1.0 + q * (-0.5 + q * y)


def sin(x):
    """Sine of an angle in rad."""
    return cos(x - 1.5707963267948966)
