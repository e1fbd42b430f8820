"""The benchmark: how well controllers keep two motors together, on fixed pairs of valves.

suite       which splits, scenarios, cases and metrics there are (data in suite.yaml)
cells       one controller on one split and scenario: driven, scored, summed up
command     `hydro-env benchmark`: runs controllers on the suite
result      result files that others can cite and check
statistics  interquartile mean, bootstrap interval, CVaR, probability of improvement
report      the score board for the terminal and as a page
"""
