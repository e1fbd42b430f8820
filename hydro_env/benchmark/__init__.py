"""The benchmark: how well controllers keep two motors together, on fixed pairs of valves.

suite       which splits, scenarios, cases and metrics there are (data in suite.yaml)
command     `hydro-env benchmark`: runs controllers on the suite
statistics  interquartile mean, bootstrap interval, CVaR, probability of improvement
report      the score board for the terminal and as a page
"""
