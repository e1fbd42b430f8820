"""The stages of a diagnosis."""
