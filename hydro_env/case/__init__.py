"""A case: a diagnosis that asks for experiments until it is sure. Its folder holds all logs and the story so far."""
