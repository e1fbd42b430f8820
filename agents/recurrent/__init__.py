"""A policy that is one recurrent network from the plain observation to both commands: `python -m agents.recurrent`."""
