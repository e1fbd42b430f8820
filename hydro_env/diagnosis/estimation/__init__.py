"""Parameter estimation: unknowns, noise, least squares, multistart, uncertainty."""
