"""Training workshop, run from a checkout: `python -m agents.train --config configs/ppo.yml --out DIR`."""
