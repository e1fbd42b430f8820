"""The plant: two hydraulic motors, each behind its own proportional valve.

parameters  the base parameters with unit, plausible range, source and reading
effects     the catalogue of effects: what a real rig does that the base equations leave out
rhs         the one right-hand side
compile     turns right-hand side and effects into the vectorised kernel
lanes       writes its statements as vector instructions
model       a rig as data: presets and model files
plant       many rigs side by side
reference   an independent simulator on the plain equations, which checks the kernel
"""

from .catalogue.effects import BUILT_IN, CATALOGUE, Effect, State, register, unregister
from .catalogue.user_files import load_effects
from .model import PlantModel, load_model, parameter_of, preset_names
from .parameters import PARAMETERS, Parameter
from .plant import SIGNALS, Plant, simulate

__all__ = [
    "BUILT_IN",
    "CATALOGUE",
    "PARAMETERS",
    "SIGNALS",
    "Effect",
    "Parameter",
    "Plant",
    "PlantModel",
    "State",
    "load_effects",
    "load_model",
    "parameter_of",
    "preset_names",
    "register",
    "simulate",
    "unregister",
]
