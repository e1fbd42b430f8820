"""Controllers, vectorised over rigs, on the same observations the learning agents get.

controller = make_controller("cross_coupled")
controller.drives(model)                      # the `PlantModel` of the rig; the paper's unless told
controller.reset(num_rigs, control_period)
action = controller.act(observation)          # (num_rigs, n) -> (num_rigs, 2)
"""

from hydro_env.controllers.base import Controller, Gain
from hydro_env.controllers.registry import CONTROLLERS, LAWS, make_controller

__all__ = ["CONTROLLERS", "LAWS", "Controller", "Gain", "make_controller"]
