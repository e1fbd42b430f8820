"""What `env.spec` says of an environment that was made: the length of its episodes, and whether the reward threshold holds.

Gymnasium's own limit of time (`max_episode_steps` of the registered specification) is one number for every scenario and control
period, and would cut longer episodes off. So none is registered: the environment ends its episodes itself, and the specification
of the environment that was made has the length of its own.
"""

from __future__ import annotations

from dataclasses import replace

from gymnasium.envs.registration import EnvSpec, registry

__all__ = ["made_spec"]

#: Arguments under which a return means the same as with those registered, for which the threshold was measured.
SAME_TASK = {
    "render_mode",
    "render_width",
    "history",
    "increment",
    "errors",
    "dtype",
    "num_envs",
    "vectorization_mode",
    "autoreset_mode",
}


def made_spec(spec: EnvSpec | None, steps: int) -> EnvSpec | None:
    """The specification that Gymnasium gives to a new environment, with the length of its episodes in steps; without a
    reward threshold where the arguments make it another task."""
    if spec is None:
        return None
    registered = registry[spec.id].kwargs if spec.id in registry else {}
    changed = {
        name for name, value in spec.kwargs.items() if name not in registered or registered[name] != value
    }
    threshold = None if changed - SAME_TASK else spec.reward_threshold
    return replace(spec, max_episode_steps=steps, reward_threshold=threshold)
