"""Which rows and signals of the logs a diagnosis uses."""
