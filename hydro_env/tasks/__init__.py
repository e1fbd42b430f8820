"""The task apart from the plant: what is driven, how valves differ, how it is scored.

scenarios  set-point and loads over time
mismatch   splits, distributions and named pairs of valves (data in splits.yaml)
metrics    scores of recorded episodes
"""

from .metrics import METRICS, Metric, Trace, compute
from .mismatch import NAMED_PAIRS, SPLITS, Mismatch, Pairs, draw_pairs, load_mismatch
from .scenarios import NOMINAL_TORQUE, SCENARIOS, Reference, Scenario, load_scenario

__all__ = [
    "METRICS",
    "NAMED_PAIRS",
    "NOMINAL_TORQUE",
    "SCENARIOS",
    "SPLITS",
    "Metric",
    "Mismatch",
    "Pairs",
    "Reference",
    "Scenario",
    "Trace",
    "compute",
    "draw_pairs",
    "load_mismatch",
    "load_scenario",
]
