"""Parts that drive or load a mechanism, declared by one call each: a DC motor, a gearbox, a PI controller, a load.

Each consists of elements that a user could declare: states, bodies, drives, parameters, outputs. Their names begin with
the name of the part. `blocks` has parts as mechanisms of their own, to be connected as FMUs.

Other rooms import `blocks`.
"""

from .control import pi_controller
from .load import Load, load
from .motor import Gearbox, Motor, dc_motor

__all__ = ["Gearbox", "Load", "Motor", "dc_motor", "load", "pi_controller"]
