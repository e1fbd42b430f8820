"""`hydro-env diagnose`: one diagnosis, or a case that asks for experiments until it is sure, in a folder with all logs."""
