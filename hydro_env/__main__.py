"""`python -m hydro_env` is `hydro-env`."""

from hydro_env.cli import main

main()
