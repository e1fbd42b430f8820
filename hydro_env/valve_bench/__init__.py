"""The valve bench: steady flow over signal of one valve, and the figures that ISO 10770-1 asks of it.

    curve.py     one recorded sweep, its branches, and the loop they form
    record.py    sweeps of a modelled valve in the plant's kernel
    read.py      a measured curve from a file
    figures.py   dead zone, hysteresis, gain, linearity, symmetry, maximum flow, null, threshold
    rates.py     several sweep rates: is the loop lag or hysteresis?
    bench.py     several valves, modelled or measured, with their sweeps and figures; how far apart two are
    page.py      the page of a valve test, and its pictures

The bench needs the plant and nothing above it, so that a controller may use what it identifies.
"""

from hydro_env.valve_bench.bench import distance, most_alike
from hydro_env.valve_bench.curve import Curve, Loop, loop_of
from hydro_env.valve_bench.figures import Figures, Side, identify, sides_of
from hydro_env.valve_bench.rates import RateCheck, check_rates
from hydro_env.valve_bench.read import Columns, read_curve
from hydro_env.valve_bench.record import record, record_rigs

__all__ = [
    "Columns", "Curve", "Figures", "Loop", "RateCheck", "Side", "check_rates", "distance", "identify", "loop_of",
    "most_alike", "read_curve", "record", "record_rigs", "sides_of",
]  # fmt: skip
