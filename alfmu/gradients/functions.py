"""Functions of a run: a number computed from its columns, with its derivatives by their entries.

An expression is the name of an output or input, or a function of a mapping from names to symbols, such as `lambda o:
o["A.torque"] * o["crank.angular_velocity"]`, in CasADi functions, which CasADi differentiates.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..model.errors import InputError

Expression = str | Callable[[Mapping[str, Any]], Any]
"""A column by its name, or a function of columns by name; `"time"` is the time [s]."""

TIME = "time"
"""Name of the time [s] in expressions."""


class _Names(Mapping[str, Any]):
    """Symbols by name, created on first access."""

    def __init__(self, make: Callable[[str], Any]):
        self._make = make
        self.made: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        if not isinstance(name, str):
            raise InputError(f"an expression of a run takes names of columns, not {name!r}")
        return self.made.setdefault(name, self._make(name))

    def __iter__(self) -> Iterator[str]:
        return iter(self.made)

    def __len__(self) -> int:
        return len(self.made)


def _evaluated(expression: Expression, names: _Names) -> ca.SX:
    """Return the symbolic expression; raise InputError if it is not one."""
    if isinstance(expression, str):
        return names[expression]
    try:
        return ca.SX(expression(names))
    except (TypeError, AttributeError, NotImplementedError, ValueError, ArithmeticError, RuntimeError) as error:
        why = str(error).strip().partition("\n")[0]
        raise InputError(
            f"an expression of a run cannot be differentiated ({why}); it must be one expression of columns, by "
            "CasADi's functions"
        ) from error


class Function(ABC):
    """A number that depends on the columns of a run."""

    names: tuple[str, ...] = ()
    """Columns of the run that the function needs, in order, without the time."""

    @abstractmethod
    def weighed(self, times: NDArray[np.float64], columns: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        """Return the number for columns (k, names) at times (k,) [s], and its derivatives by each entry."""


class _OfExpression(Function):
    """A function of the values of an expression at all communication points."""

    def __init__(self, expression: Expression):
        names = _Names(ca.SX.sym)
        value = _evaluated(expression, names)
        if value.shape != (1, 1):
            raise InputError(f"an expression of a run must be one number, not {value.shape[0]} by {value.shape[1]}")
        self._expression = expression
        self.names = tuple(name for name in names.made if name != TIME)
        symbols = ca.vertcat(*(names.made[name] for name in self.names))
        if not (self.names and ca.depends_on(value, symbols)):
            raise InputError(
                "an expression of a run takes no column, so that it has no derivative; name columns, and use CasADi's "
                "functions"
            )
        time = names.made.get(TIME, ca.SX.sym(TIME))
        self._value = ca.Function("value", [symbols, time], [value, ca.jacobian(value, symbols)])

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self._expression!r})"

    def _at_each(
        self, times: NDArray[np.float64], columns: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return values (k,) and derivatives (k, names) of the expression."""
        values, slopes = self._value.map(len(times))(columns.T, times[None, :])
        return np.array(values).ravel(), np.array(slopes).reshape(len(times), len(self.names))


class Final(_OfExpression):
    """An expression at the end of the run."""

    def weighed(self, times: NDArray[np.float64], columns: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        values, slopes = self._at_each(times, columns)
        slopes[:-1] = 0.0
        return float(values[-1]), slopes


class Integral(_OfExpression):
    """The integral of an expression over the time, by the trapezoidal rule between communication points."""

    def weighed(self, times: NDArray[np.float64], columns: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        values, slopes = self._at_each(times, columns)
        steps = np.diff(times)
        shares = (np.append(steps, 0.0) + np.insert(steps, 0, 0.0)) / 2
        return float(shares @ values), shares[:, None] * slopes


class Maximum(_OfExpression):
    """The maximum of an expression, from the parabola through the largest value and its neighbours.

    If two peaks are equally high, its derivative is that of the first one.
    """

    _result = 0
    """Number of its result among those of `_peak`: 0 for the maximum, 1 for its time."""

    def weighed(self, times: NDArray[np.float64], columns: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        values, slopes = self._at_each(times, columns)
        k = int(np.argmax(values))
        weights = np.zeros_like(slopes)
        if not 0 < k < len(times) - 1:
            weights[k] = 0.0 if self._result else slopes[k]
            return float((values, times)[self._result][k]), weights
        found, by = _PEAK(times[k - 1 : k + 2], values[k - 1 : k + 2])[2 * self._result :][:2]
        weights[k - 1 : k + 2] = np.array(by).reshape(3, 1) * slopes[k - 1 : k + 2]
        return float(found), weights


class TimeOfMaximum(Maximum):
    """The time [s] at which an expression is largest; its derivatives are zero at an end of the run."""

    _result = 1


def _peak() -> ca.Function:
    """Return the vertex of the parabola through three points, its time, and their derivatives by the three values."""
    t, y = ca.SX.sym("t", 3), ca.SX.sym("y", 3)
    before, behind = (y[1] - y[0]) / (t[1] - t[0]), (y[2] - y[1]) / (t[2] - t[1])
    curvature = (behind - before) / (t[2] - t[0])
    slope = before + curvature * (t[1] - t[0])
    flat = curvature >= 0  # the three values are equal
    shift = ca.if_else(flat, 0.0, -slope / (2 * ca.if_else(flat, -1.0, curvature)))
    top, time = y[1] + shift * (slope + curvature * shift), t[1] + shift
    return ca.Function("peak", [t, y], [top, ca.jacobian(top, y), time, ca.jacobian(time, y)])


_PEAK = _peak()


class Columns(Function):
    """A function of whole columns, for example the error of a path.

    `names` are the columns; `expression` takes a mapping from them, and from `"time"`, to CasADi vectors (k,)::

        Columns(["P.x"], lambda o: ca.sumsqr(o["P.x"] - wanted))
    """

    def __init__(self, names: Sequence[str], expression: Callable[[Mapping[str, Any]], Any]):
        if isinstance(names, str) or not names:
            raise InputError(f"names is {names!r}; give a list of columns")
        self.names = tuple(names)
        self._expression = expression

    def __repr__(self) -> str:
        return f"Columns({list(self.names)!r}, {self._expression!r})"

    def weighed(self, times: NDArray[np.float64], columns: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        symbols = ca.MX.sym("columns", len(times), len(self.names))
        given: dict[str, Any] = {name: symbols[:, k] for k, name in enumerate(self.names)}
        try:
            value = ca.MX(self._expression({**given, TIME: ca.DM(times)}))
        except (KeyError, TypeError, AttributeError, NotImplementedError, RuntimeError) as error:
            raise InputError(
                f"a function of columns cannot be evaluated: {error}; name its columns, and use CasADi's functions"
            ) from error
        if value.shape != (1, 1):
            raise InputError(f"a function of columns must be one number, not {value.shape[0]} by {value.shape[1]}")
        found, slopes = ca.Function("value", [symbols], [value, ca.gradient(value, symbols)])(columns)
        return float(found), np.array(slopes).reshape(columns.shape)
