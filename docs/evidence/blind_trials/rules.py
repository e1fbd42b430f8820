"""Rules of the diagnosis, steps that rescue a fit or question a name, and how each is switched off, to measure what it is worth.

A rule is off while a function or constant of the diagnosis is another one, see `running.changed`.
"""

from __future__ import annotations

import math
from typing import Any

#: By rule what is changed in the diagnosis, by name.
RULES: dict[str, dict[str, Any]] = {
    # compare a set of local effects with one that has an effect of the whole rig
    "compare_sets": {"stages.selection._may_be_outdone": lambda search, first: first and not search.accepted},
    # compare all candidates on the beginning of the logs where the best one leaves something
    "compete_on_beginning": {"stages.selection._compete_on_beginning": lambda search, refits: {}},
    # correct the form of named and given effects
    "correct_form": {"stages.form_correction.attempts": lambda *given, **more: []},
    # reject names that leave much of a signal of the fit logs, whatever their form
    "doubt_left": {"stages.verdict.LEFT_NOISE": math.inf},
    # reject names whose interval holds the neutral value
    "doubt_neutral": {"stages.verdict._absent": lambda logs, accepted, final: iter(())},
    # reject names that make a signal worse of the held-out logs
    "doubt_worse": {"stages.verdict.WORSE_NOISE": math.inf, "stages.verdict._worse": lambda entry: False},
    # follow the measured speed where a coupling rattles, which multiplies every difference
    "follow_speed": {"stages.rattling.EFFECT": ""},
    # fit what is far from the noise to the beginning of the logs first
    "grow_horizon": {"estimation.local_minima.FAR": math.inf},
    # drop an effect if another form of those beside it explains more
    "prefer_form": {"stages.selection.prefer_form": lambda search: None},
    # restart the calibration with other spool friction where a little more than noise is left
    "restart_friction": {"estimation.local_minima.MAX_TIMES": 0},
}
