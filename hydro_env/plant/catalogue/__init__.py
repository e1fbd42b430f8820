"""The catalogue of effects: what a real rig does that the paper's equations leave out.

effect            what an effect is; the catalogue and how to register in it
driver ... sensor the effects of each port, a file for each, in the order in which the signal passes them
losses            published loss models of the motor
form_corrections  corrections of an effect's form, fitted by the diagnosis
user_files        Python files with users' own effects

A new effect of the package is one entry in the file of its port, where `effect.Effect` says what it declares. Its independent
law stands in `practice.reference`, its test in tests/plant/test_effects.py.
"""

from importlib import import_module

from . import form_corrections
from .effect import CATALOGUE, PORTS, Effect, register, separating_experiment

__all__ = ["BUILT_IN", "CATALOGUE", "PORTS", "Effect", "separating_experiment"]

for _file in (*PORTS, "losses"):
    for _effect in import_module(f"{__name__}.{_file}").EFFECTS:
        register(_effect)

#: The effects that ship with the package; any other one is a user's (see `register` and `user_files`).
BUILT_IN = tuple(CATALOGUE)

# Corrections of form are effects of a model file as well, but none that a rig is known to have.
for _effect in form_corrections.EFFECTS:
    register(_effect)
