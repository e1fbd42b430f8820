"""Practice rigs: an independent reference simulator and the logs that it makes with effects hidden in them."""
