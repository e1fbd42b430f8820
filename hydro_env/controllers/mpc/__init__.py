"""Controllers that plan their commands on a model."""
