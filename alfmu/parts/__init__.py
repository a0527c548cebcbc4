"""Parts that a mechanism is driven by, declared in one call each: a DC motor, a gearbox, a PI controller.

Each is made of what a user could declare too: states, bodies, drives, parameters, outputs. Their names begin with the
name of the part.
"""

from .control import pi_controller
from .motor import Gearbox, Motor, dc_motor

__all__ = ["Gearbox", "Motor", "dc_motor", "pi_controller"]
