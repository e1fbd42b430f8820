"""The plant: two hydraulic motors, each behind its own proportional valve.

parameters   the base parameters with unit, plausible range, source and reading
catalogue    the effects: what a real rig does that the base equations leave out, a file for each port
rhs          the one right-hand side, which calls the laws of the effects by the quantity that they change
vector_math  the functions that laws may use
kernel       compiles right-hand side and effects into a vectorised step
model        a rig as data: model files, and the `presets` that ship
scales       how large a rig is beside the paper's, and what follows for what is usual on it
friction     dry friction of a spool that is left
plant        many rigs side by side
sensors      noise of the sensors
motor_map    steady flow, torque and efficiency of a model's motor
"""

from .catalogue import BUILT_IN, CATALOGUE, Effect
from .catalogue.effect import State, parameter_of, register, unregister
from .catalogue.user_files import load_effects
from .model import PlantModel
from .model_files import load_model, preset_names
from .parameters import PARAMETERS, Parameter
from .plant import SIGNALS, Plant, simulate
from .scales import PAPER, Scales, scales_of

__all__ = [
    "BUILT_IN", "CATALOGUE", "PAPER", "PARAMETERS", "SIGNALS", "Effect", "Parameter", "Plant", "PlantModel", "Scales",
    "State", "load_effects", "load_model", "parameter_of", "preset_names", "register", "scales_of", "simulate", "unregister",
]  # fmt: skip
