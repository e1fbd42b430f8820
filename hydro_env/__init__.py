"""Two hydraulic motors behind two unequal proportional valves.

hydro_env.plant         the rig: equations, effects, fast batched simulation
hydro_env.envs          the Gymnasium environments `HydraulicSync-v0`, `HydraulicSyncIncrement-v0`, `HydraulicSyncTraining-v0`
hydro_env.controllers   classical and learned controllers
hydro_env.benchmark     their scores on a fixed suite
hydro_env.diagnosis     what a model lacks, found from logs
hydro_env.experiments   the paper's experiments, speed, the demo
"""

from gymnasium.envs.registration import register as _register

__version__ = "1.0.0"
__all__ = ["__version__"]

# Actions change the command, as in the velocity form of a PID, so that a policy without memory can integrate.
_INCREMENT = {"increment": 0.3, "history": 2, "errors": True}
# Discounted returns of about one, which the critics of the usual trainers learn at once.
_SMALL = {"tracking": 0.08, "difference": 0.18, "variation": 0.002}

# Thresholds: mean return of `cross_coupled` in the default task, rounded (`python -m agents.baselines --lines --pairs 500`).
# Episodes end themselves: see `envs.env_spec`.
for _id, _arguments, _threshold in (
    ("HydraulicSync-v0", {}, -150.0),
    ("HydraulicSyncIncrement-v0", _INCREMENT, -150.0),
    ("HydraulicSyncTraining-v0", {**_INCREMENT, "reward": _SMALL}, -22.0),
):
    _register(
        id=_id,
        entry_point="hydro_env.envs.hydraulic_sync:HydraulicSyncEnv",
        vector_entry_point="hydro_env.envs.batch:HydraulicSyncVectorEnv",
        kwargs=_arguments,
        reward_threshold=_threshold,
    )
