"""How far apart two valves are, and which pair of several is nearest.

The distance is the root of the mean squared difference of flow over both branches and the signals, from minus to plus
the rated signal, that both valves were driven over, in percent of the largest flow of all. It asks what the same signal
does on either valve, which is what a synchronising drive meets.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from hydro_env.errors import InputError
from hydro_env.valve_bench.curve import FLOW, Curve, Floats, Loop, loop_of

__all__ = ["distance", "most_alike"]


def distance(first: Curve, second: Curve, full_flow: float | None = None) -> float:
    """Distance of two valves in percent of `full_flow` (m3/s; their own largest flow if None).

    InputError if one of them is no flow curve, or they share no range of the signal.
    """
    loops = [_flow_loop(curve) for curve in (first, second)]
    low = max(loop.low / curve.rated for loop, curve in zip(loops, (first, second), strict=True))
    high = min(loop.high / curve.rated for loop, curve in zip(loops, (first, second), strict=True))
    if not high - low > 0.1:
        raise InputError(
            f"{first.name} and {second.name} were not driven over the same signals: compare like with like"
        )
    share = np.linspace(low, high, 801)
    flows = [_flows(loop, share * curve.rated) for loop, curve in zip(loops, (first, second), strict=True)]
    full = full_flow or max(float(np.abs(flow).max()) for flow in flows)
    return 100.0 * float(np.sqrt(np.mean((flows[0] - flows[1]) ** 2))) / full


def most_alike(curves: Sequence[Curve]) -> list[tuple[float, int, int]]:
    """All pairs, the most alike first: (distance in percent of the largest flow of all, first, second)."""
    full = max(float(np.abs(curve.flow).max()) for curve in curves)
    pairs = itertools.combinations(range(len(curves)), 2)
    return sorted((distance(curves[i], curves[j], full), i, j) for i, j in pairs)


def _flow_loop(curve: Curve) -> Loop:
    loop = loop_of(curve)
    if loop.kind != FLOW:
        raise InputError(f"{curve.name}: a leakage curve; only flow curves can be compared")
    return loop


def _flows(loop: Loop, signal: Floats) -> Floats:
    """Rising and falling flow (2, signals); a missing branch is taken to be like the other."""
    rising = loop.rising or loop.falling
    falling = loop.falling or loop.rising
    assert rising is not None and falling is not None
    return np.array([rising.flow_at(signal), falling.flow_at(signal)])
