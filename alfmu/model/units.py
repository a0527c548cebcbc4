"""SI units as data: their exponents for FMI unit definitions, and display units."""

import re
from dataclasses import dataclass, field

from .errors import DeclarationError
from .words import in_words, nearest, shown


@dataclass(frozen=True)
class Unit:
    """A unit: exponents of the SI base units, and display units as name -> factor (display = factor * value)."""

    name: str
    exponents: dict[str, int]
    display: dict[str, float] = field(default_factory=dict)


_DEGREES = 57.29577951308232

UNITS: dict[str, Unit] = {
    u.name: u
    for u in (
        Unit("1", {}),
        Unit("s", {"s": 1}, {"ms": 1e3}),
        Unit("1/s", {"s": -1}),
        Unit("1/s2", {"s": -2}),
        Unit("m", {"m": 1}, {"mm": 1e3}),
        Unit("m/s", {"m": 1, "s": -1}),
        Unit("m/s2", {"m": 1, "s": -2}),
        Unit("rad", {"rad": 1}, {"deg": _DEGREES}),
        Unit("rad/s", {"rad": 1, "s": -1}, {"deg/s": _DEGREES, "r/min": 9.549296585513721}),
        Unit("rad/s2", {"rad": 1, "s": -2}),
        Unit("s/m", {"s": 1, "m": -1}),
        Unit("kg", {"kg": 1}),
        Unit("kg.m2", {"kg": 1, "m": 2}),
        Unit("N", {"kg": 1, "m": 1, "s": -2}, {"kN": 1e-3}),
        Unit("N.m", {"kg": 1, "m": 2, "s": -2}),
        Unit("N.s", {"kg": 1, "m": 1, "s": -1}),
        Unit("N.m.s", {"kg": 1, "m": 2, "s": -1}),
        Unit("N/m", {"kg": 1, "s": -2}),
        Unit("Pa", {"kg": 1, "m": -1, "s": -2}, {"bar": 1e-5}),
        Unit("m/N", {"kg": -1, "s": 2}),
        Unit("rad/(N.m)", {"kg": -1, "m": -2, "s": 2, "rad": 1}),
        Unit("N.s/m", {"kg": 1, "s": -1}),
        Unit("N.m/rad", {"kg": 1, "m": 2, "s": -2, "rad": -1}),
        Unit("N.m.s/rad", {"kg": 1, "m": 2, "s": -1, "rad": -1}),
        Unit("J", {"kg": 1, "m": 2, "s": -2}),
        Unit("W", {"kg": 1, "m": 2, "s": -3}),
        Unit("m2", {"m": 2}),
        Unit("kg/m3", {"kg": 1, "m": -3}),
        Unit("m3", {"m": 3}, {"l": 1e3}),
        Unit("m3/s", {"m": 3, "s": -1}),
        Unit("kg/s", {"kg": 1, "s": -1}),
        Unit("Pa/s", {"kg": 1, "m": -1, "s": -3}),
        Unit("A", {"A": 1}, {"mA": 1e3}),
        Unit("A/s", {"A": 1, "s": -1}),
        Unit("C", {"A": 1, "s": 1}),
        Unit("V", {"kg": 1, "m": 2, "s": -3, "A": -1}),
        Unit("V/s", {"kg": 1, "m": 2, "s": -4, "A": -1}),
        Unit("Ohm", {"kg": 1, "m": 2, "s": -3, "A": -2}),
        Unit("H", {"kg": 1, "m": 2, "s": -2, "A": -2}, {"mH": 1e3}),
        Unit("F", {"kg": -1, "m": -2, "s": 4, "A": 2}),
        Unit("N.m/A", {"kg": 1, "m": 2, "s": -2, "A": -1}),
        Unit("V.s/rad", {"kg": 1, "m": 2, "s": -2, "A": -1, "rad": -1}),
        Unit("K", {"K": 1}),
        Unit("K/s", {"K": 1, "s": -1}),
        Unit("J/K", {"kg": 1, "m": 2, "s": -2, "K": -1}),
        Unit("W/K", {"kg": 1, "m": 2, "s": -3, "K": -1}),
    )
}

_FACTOR = r"[A-Za-z]+\d*"
_PRODUCT = rf"{_FACTOR}(\.{_FACTOR})*"
"""The name of a product of units."""

_RATES = {"m": "m/s", "rad": "rad/s", "m/s": "m/s2", "rad/s": "rad/s2", "1": "1/s", "1/s": "1/s2"}


def unit(name: str) -> Unit:
    """Return the unit called `name`; raise DeclarationError for an unknown one."""
    if isinstance(name, str) and name in UNITS:
        return UNITS[name]
    for si, factor in ((u.name, u.display[name]) for u in UNITS.values() if name in u.display):
        raise DeclarationError(f"the unit {name!r} is for display alone; give {si} (1 {si} is {factor:g} {name})")
    plain = {_plain(each): each for each in UNITS}
    meant = [plain[each] for each in (_plain(str(name)), _plain(str(name)).upper()) if each in plain]
    meant = meant[:1] or nearest(name, UNITS)
    advice = f"did you mean {in_words(meant)}?" if meant else f"use one of: {', '.join(UNITS)}"
    raise DeclarationError(f"unknown unit {shown(name)}; {advice}")


def alike(one: str, other: str) -> bool:
    """Return whether two units measure the same quantity; an angle counts as a number."""
    first, second = ({k: x for k, x in unit(name).exponents.items() if k != "rad"} for name in (one, other))
    return first == second


def is_rate(one: str, other: str) -> bool:
    """Return whether the first unit measures the time derivative of a quantity in the second; an angle counts as a
    number."""
    first, second = ({k: x for k, x in unit(name).exponents.items() if k != "rad"} for name in (one, other))
    second["s"] = second.get("s", 0) - 1
    return first == {k: x for k, x in second.items() if x}


def rate_of(name: str) -> str:
    """Return the name of the unit of the time derivative of a quantity in the unit called `name`."""
    try:
        return _RATES[unit(name).name]
    except KeyError:
        raise DeclarationError(f"a coordinate is in m, rad or 1, not in {name!r}") from None


def quotient(one: str, other: str) -> str:
    """Return the name of the quotient of two units: that of rad and N.m is rad/(N.m)."""
    if other == "1":
        return one
    powers = _powers(one)
    for base, power in _powers(other).items():
        powers[base] = powers.get(base, 0) - power
    above, below = (
        ".".join(f"{base}{abs(power)}".removesuffix("1") for base, power in powers.items() if power * sign > 0)
        for sign in (1, -1)
    )
    name = f"{above or 1}/({below})" if "." in below else f"{above or 1}/{below}" if below else above or "1"
    exponents = composed(name).exponents
    return next((known.name for known in UNITS.values() if known.exponents == exponents), name)


def composed(name: str) -> Unit:
    """Return the unit called `name`, or a quotient of units, as `quotient` calls it; raise DeclarationError if it is
    neither."""
    if name in UNITS or not re.fullmatch(rf"({_PRODUCT}|1)(/{_FACTOR}|/\({_PRODUCT}\))?", name):
        return unit(name)
    exponents: dict[str, int] = {}
    for part, power in _powers(name).items():
        for base, exponent in unit(part).exponents.items():
            exponents[base] = exponents.get(base, 0) + power * exponent
    return Unit(name, {base: exponent for base, exponent in exponents.items() if exponent})


def _powers(name: str) -> dict[str, int]:
    """Return the units that a name is made of, each with its power."""
    above, _, below = name.partition("/")
    found: dict[str, int] = {}
    for part, sign in ((above, 1), (below, -1)):
        for base, power in re.findall(r"([A-Za-z]+)(\d*)", part):
            found[base] = found.get(base, 0) + sign * int(power or 1)
    return found


def _plain(name: str) -> str:
    """Return a unit without optional notation: dots, spaces, powers."""
    return "".join(c for c in name if c not in " .*^·")
