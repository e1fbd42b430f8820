"""A public benchmark for naming missing physics: rigs with hidden effects, methods that name them, scores.

sets        makes a set of rigs: what a method gets, and the truth in a folder of its own
answers     one JSON file for each rig: what any method hands in
methods     the diagnosis, alone and with questions, and the calibration alone, through that interface
dialogue    questions that a rig answers with logs, within a budget
scoring     answers against the truth, with intervals, and what whole diagnoses say of their own certainty
"""
