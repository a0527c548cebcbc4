"""A proportional-integral controller with limits.

With e the difference of the wanted and the measured value,

    u = K e + z within its limits,      dz/dt = K e / T + (u - K e - z) / T,

so that the integral part z stops growing at the limits (anti-windup by back-calculation).
"""

from __future__ import annotations

import casadi as ca

from ..model.calls import explained
from ..model.errors import DeclarationError
from ..model.mechanism import Mechanism
from ..model.parts import Scalar, symbolic
from ..model.units import UNITS, quotient
from .declared import label, named, of


@explained
def pi_controller(
    m: Mechanism,
    name: str,
    *,
    wanted: Scalar,
    measured: Scalar,
    gain: Scalar,
    time: Scalar,
    limit: Scalar | None = None,
    units: tuple[str, str] = ("rad/s", "V"),
    start: float = 0.0,
    nominal: float = 1.0,
) -> ca.SX:
    """Add a PI controller; return its output, for a motor or a drive.

    `wanted` and `measured` are expressions in the first of `units`; `measured` may depend on coordinates, rates, states
    and inputs, not on accelerations. `gain` [second unit over first] and the integral time `time` [s] are numbers,
    which become the parameters `<name>.gain` and `<name>.time`, or expressions in parameters. The output stays within
    +-`limit`, the parameter `<name>.limit` [second unit]. `start` is the initial integral part, `nominal` the order of
    magnitude of the output (as in `Mechanism.state`).

    Outputs are `<name>.output`, `<name>.error`, and the state `<name>.integral`. Raises DeclarationError if `units` is
    not a pair of units, or an argument is invalid.
    """
    if not isinstance(units, tuple | list) or len(units) != 2:
        raise DeclarationError(
            f'{m.name}: the units of the controller {name} are {units!r}; give two, as ("rad/s", "V"): of the '
            "measured quantity and of the output"
        )
    of_error, of_output = units
    of_gain = quotient(of_output, of_error)
    K = named(m, name, "gain", gain, of_gain if of_gain in UNITS else "1", "gain")
    T = named(m, name, "time", time, "s", "time of the integral part", minimum=1e-9)
    error = wanted - measured
    z = m.state(
        label(name, "integral"), of_output, start=start, nominal=nominal, description=f"integral part{of(name)}"
    )
    asked = K * error + z
    output = asked
    if limit is not None:
        most = named(m, name, "limit", limit, of_output, "largest output", minimum=0.0)
        output = ca.fmax(-most, ca.fmin(most, asked))
    m.derivative(z, (K * error + output - asked) / T)
    m.output(label(name, "error"), error, of_error, f"control error{of(name)}")
    m.output(label(name, "output"), output, of_output, f"output{of(name)}")
    return symbolic(output)
