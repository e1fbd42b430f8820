"""Practice rigs: an independent reference simulator, another one with four edges and two lines, and logs with effects hidden."""
