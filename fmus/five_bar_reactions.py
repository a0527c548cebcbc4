"""FMU of the five-bar linkage for a study of its joints: a heavier link 4, angles and reactions alone."""

from alfmu import Recipe
from alfmu.fmi.entry import Entry

recipe = Recipe(
    "five_bar",
    options={"coordinates": "joint"},
    parameters={"m4": 2.0, "start.angular_velocity": 1.5, "solver.relative_tolerance": 1e-7},
    outputs=["link*.angle", "*.force.*", "monitor.singular"],
    freeze=["l", "g"],
    stop_time=5.0,
    communication_step=0.01,
)


class FiveBarReactions(Entry, recipe=recipe):
    """The five-bar linkage and its reactions behind FMI 2.0."""
