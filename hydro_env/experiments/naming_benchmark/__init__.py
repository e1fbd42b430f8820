"""A public benchmark for naming missing physics: rigs with hidden effects, methods that name them, scores.

sets        makes a set of rigs: what a method gets, and the truth in a folder of its own
answers     one JSON file for each rig: what any method hands in
methods     the diagnosis and four simple methods, all through that interface
residual    errors of the equations of coil, line and shaft beside a calibrated model, and the terms of every candidate
correction  a black box added to the right-hand side of the line
certainty   intervals and probabilities of whole diagnoses against the truth
scoring     answers against the truth, with intervals
"""
