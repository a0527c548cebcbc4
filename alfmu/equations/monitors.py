"""What a run reports beside the outputs of a mechanism: monitors of the method, and what impacts did."""

from __future__ import annotations

from .types import Equations, Variable

__all__ = ["MONITORS", "events", "every_event"]

MONITORS = (
    Variable("monitor.position_error", "1", description="largest |Phi| (m, rad)"),
    Variable("monitor.velocity_error", "1", description="largest |Phi-dot| (m/s, rad/s)"),
    Variable("monitor.energy", "J", description="kinetic and potential energy"),
    Variable(
        "monitor.iterations",
        "1",
        description="multiplier iterations used at this instant",
        type="Integer",
        instant=True,
    ),
    Variable(
        "monitor.distance",
        "1",
        description="distance to a singular position: square root of the smallest pivot of the augmented mass, over "
        "its diagonal entry and apart from those of masses; rad for links of similar lengths",
    ),
    Variable(
        "monitor.singular",
        "1",
        description="0 regular; at a singular position 1 where reactions have a limit, which is given, "
        "2 where they grow without bound on both sides",
        type="Integer",
        instant=True,
    ),
)
"""What every instance says about its own accuracy."""


def events(equations: Equations) -> list[Variable]:
    """What is reported of impacts: the last impulse of each constraint that can be switched, the energy lost so far."""
    return [v for v in every_event(equations) if v.name not in equations.monitors]


def every_event(e: Equations) -> list[Variable]:
    """The same with those that are left out."""
    found = []
    for row in (e.rows[i] for switch in e.switches for i in switch.rows):
        name = f"{row.name}.impulse" if row.direction == "locked" else f"{row.name}.impulse.{row.direction}"
        text = f"last impulse of {row.name} when it came into force"
        found.append(Variable(name, "N.m.s" if row.unit == "rad" else "N.s", description=text))
    if e.switches:
        found.append(Variable("monitor.energy_lost", "J", description="kinetic energy that impacts took so far"))
    return found
