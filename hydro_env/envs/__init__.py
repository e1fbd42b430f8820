"""The environment `HydraulicSync-v0`.

hydraulic_sync  the single environment; its docstring is the manual
batch           many of them at once, and all that the task does
observation     what a controller sees: names, scales, decoding
privileged      what it does not see, for a critic
reward          what a step costs
"""

from .batch import HydraulicSyncVectorEnv
from .hydraulic_sync import HydraulicSyncEnv
from .observation import OBSERVATION, Measurements, decode
from .privileged import privileged_names
from .reward import Reward

__all__ = [
    "OBSERVATION", "HydraulicSyncEnv", "HydraulicSyncVectorEnv", "Measurements", "Reward", "decode", "privileged_names",
]  # fmt: skip
