"""Searching gains, and the files that keep them."""
