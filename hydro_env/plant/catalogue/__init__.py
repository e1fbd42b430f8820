"""The catalogue of effects: what a real rig does that the paper's equations leave out, by port."""
