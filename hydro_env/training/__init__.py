"""Training of learned agents with Stable-Baselines3 (extra `agents`): `hydro-env train`.

A training file (`config`) says which algorithm learns in which environment. `train` makes a run of it: scores on
the split `val` (`evaluate`), checkpoints from which it goes on exactly (`checkpoint`), and the best policy as plain arrays
(`export`). One run at a time works in a folder (`lock`). Nothing here is imported but by that command.
"""
