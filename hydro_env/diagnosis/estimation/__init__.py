"""Parameter estimation: what the stages of a diagnosis use.

unknowns          numbers to estimate, with bounds, scale and prior
estimate          unknowns with their values and what was simulated with these
fit               likelihood, residuals and deviance of an estimate on the logs of a model
noise             noise and independent samples of a residual
gauss_newton      the solver
final_refinement  the last steps to the minimum, with derivatives as wide as the uncertainty
early_window      fits to the beginning of the logs, of one estimate or of competing candidates
multistart        restarts, where friction makes local minima
fit_criteria      how much of a residual is explained
uncertainty       block bootstrap
"""

from .early_window import best_on_early_window, grow_horizon
from .estimate import Estimate, Vector, joined
from .final_refinement import refine
from .fit import Fit, Noise, noise_in, noise_of
from .fit_criteria import could_pay, far_from_noise, mostly_explained, unexplained
from .gauss_newton import SETTLE_ITERATIONS, differentiate, solve, step_all
from .multistart import restart_friction
from .noise import effective_samples, noise_floor
from .uncertainty import (
    CANNOT_BE_PREDICTED,
    intervals_of,
    predictions_apart,
    probability_of_gain,
    replica_differences,
    unpredictable,
)
from .unknowns import (
    SCALED_TOGETHER,
    Unknown,
    base_unknown,
    bases_of,
    effect_starts,
    effect_unknowns,
    given_unknown,
    less_taken,
    limited_by_effects,
    scaled,
    within,
)

__all__ = [
    "CANNOT_BE_PREDICTED", "SCALED_TOGETHER", "SETTLE_ITERATIONS", "Estimate", "Fit", "Noise", "Unknown", "Vector",
    "base_unknown", "bases_of", "best_on_early_window", "could_pay", "differentiate", "effect_starts", "effect_unknowns",
    "effective_samples", "far_from_noise", "given_unknown", "grow_horizon", "intervals_of", "joined", "less_taken",
    "limited_by_effects", "mostly_explained", "noise_floor", "noise_in", "noise_of", "predictions_apart", "probability_of_gain",
    "refine", "replica_differences", "restart_friction", "scaled", "solve", "step_all", "within", "unexplained", "unpredictable",
]  # fmt: skip
