"""The paper's experiments, speed and the demo: what the commands of the same names run."""
