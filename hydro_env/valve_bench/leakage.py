"""The flanks of an internal leakage curve, whose flow peaks near the null and falls to both sides.

Rising and falling sweeps are compared at equal height of a flank, each branch scaled from its own foot to its own
peak: the pressure and the oil's temperature drift between them, and a slow flow meter lowers the peak.
"""

import numpy as np
from scipy.optimize import isotonic_regression

from hydro_env.valve_bench.curve import Floats, Loop

#: Heights of the flanks that are compared.
HEIGHTS = np.linspace(0.25, 0.75, 41)

Flanks = dict[int, tuple[Floats, Floats]]


def flanks_of(loop: Loop) -> Flanks:
    """Bin averages (signal, flow) of each direction, +1 rising and -1 falling, lightly smoothed."""
    found: Flanks = {}
    for direction, branch in ((1, loop.rising), (-1, loop.falling)):
        if branch is not None:
            flow = branch.flow
            if len(flow) >= 15:
                flow = np.convolve(np.pad(flow, 2, mode="edge"), np.ones(5) / 5.0, "valid")
            found[direction] = branch.signal, flow
    return found


def peak_of(signal: Floats, flow: Floats) -> float:
    """Signal at which the leakage is largest: the vertex of a parabola through the bins above 90 % of the height."""
    height = (flow - flow.min()) / np.ptp(flow)
    top = int(np.argmax(flow))
    low = np.flatnonzero(height <= 0.9)
    left, right = low[low < top].max(initial=-1) + 1, low[low > top].min(initial=len(flow)) - 1
    if right - left < 3:
        return float(signal[top])
    x = signal[left : right + 1] - signal[top]
    a, b, _ = np.polyfit(x, height[left : right + 1], 2)
    vertex = -b / (2.0 * a) if a < 0.0 else 0.0
    return float(signal[top] + np.clip(vertex, x[0], x[-1]))


def flank_signals(signal: Floats, flow: Floats) -> Floats:
    """Signals at `HEIGHTS` on the flank below the null and on that above it, (2, heights)."""
    top = int(np.argmax(flow))
    rows = []
    for side in (slice(0, top + 1), slice(top, None)):
        x, q = signal[side], flow[side]
        if x[0] >= signal[top]:  # from the peak outwards: turned, so that the flow rises
            x, q = x[::-1], q[::-1]
        foot = float(np.min(q))
        height = isotonic_regression((q - foot) / (flow[top] - foot)).x
        height = height + 1e-9 * np.arange(len(height))
        rows.append(np.interp(HEIGHTS, height, x))
    return np.array(rows)
