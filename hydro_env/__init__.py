"""hydro_env."""
