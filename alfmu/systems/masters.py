"""Names of the master algorithms; help texts need only this light module."""

MASTERS = {
    "held": "each component holds its inputs for a communication step, as importers of FMUs do: order 1",
    "extrapolated": "inputs are extrapolated linearly from the last communication step: order 2",
    "iterated": "steps are repeated until inputs and outputs agree at their ends: order 2, and stable",
}
"""Master algorithms: the inputs within a communication step."""
