"""Trains a policy from a checkout: `python -m agents.train --config configs/ppo.yml [--resume] --out DIR`.

The same as `hydro-env train`.
"""

from __future__ import annotations

import sys

from hydro_env.cli import main

if __name__ == "__main__":
    main(["train", *sys.argv[1:]])
