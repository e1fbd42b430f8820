"""The task apart from the plant: what is driven, how valves differ, how it is scored.

scenarios  set-point and loads over time
mismatch   splits, distributions and named pairs of valves (data in splits.yaml)
metrics    scores of recorded episodes
versions   of what a score depends on
"""

from .metrics import METRICS, Metric, Trace, compute, never_settled
from .mismatch import NAMED_PAIRS, OWN, SPLITS, Mismatch, Pairs, default_mismatch, draw_pairs, load_mismatch
from .scenarios import NOMINAL_TORQUE, SCENARIOS, Reference, Scenario, load_scenario
from .versions import VERSIONS

__all__ = [
    "METRICS", "NAMED_PAIRS", "NOMINAL_TORQUE", "OWN", "SCENARIOS", "SPLITS", "VERSIONS", "Metric", "Mismatch",
    "Pairs", "Reference", "Scenario", "Trace", "compute", "default_mismatch", "draw_pairs", "load_mismatch",
    "load_scenario", "never_settled",
]  # fmt: skip
