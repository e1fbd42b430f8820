"""What a number may be compared with: versions that stand in every result."""

#: `physics`: plant, sensors and observation of the presets. `splits`: pairs of valves, scenarios and the streams that draw them.
#: `reward`: weights and formula, and costs. Whoever raises one gives the environments their next ids.
VERSIONS = {"physics": 1, "splits": 1, "reward": 1}
