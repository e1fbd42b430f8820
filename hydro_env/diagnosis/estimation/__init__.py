"""Parameter estimation: what the stages of a diagnosis use.

unknowns          numbers to estimate, with bounds, scale and prior
estimate          unknowns with their values and what was simulated with these
fit               likelihood, residuals and deviance of an estimate on the logs of a model, and how much is explained
noise             noise and independent samples of a residual
gauss_newton      the solver
final_refinement  the last steps to the minimum, with derivatives as wide as the uncertainty
local_minima      restarts with other friction, fits to the beginning of the logs, of one estimate or of competing candidates
uncertainty       block bootstrap
"""
