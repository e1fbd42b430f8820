"""Trained policies: the file, the network and its interface to the rig."""
