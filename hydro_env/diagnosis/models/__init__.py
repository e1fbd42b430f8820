"""Models of the rig that can be fitted to logs."""
