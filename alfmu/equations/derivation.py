"""Mechanism -> Equations: every matrix, energy, output and reaction by symbolic differentiation.

The inertia of a mechanism is a set of displacements X(q) with weights w (mass for the position of a centre of mass,
moment of inertia for an angle), so that

    T = v' M v / 2,  M = X_q' w X_q,  d = X_q' w (d(X_q)/dt) v.

Every suppressed direction of a joint, whether closed by a coordinate or by constraints, gets a virtual displacement eps
that moves the second body away from the first. The reaction is the generalised force that keeps eps at zero,

    r = X_eps' w a_X + V_eps - s_eps' F + Phi_eps' lambda   at eps = 0,

with a_X the accelerations of X, V the potential, s the displacements along which efforts F act. Bodies in space that
are placed by joints use recursions (`equations.space`).

If positions, constraints or energies depend on time, time is the last coordinate, with the rate 1: X(q, t) is X of all
coordinates, and d/dt contains partial time derivatives. So C v + Phi_t = 0 for (2), and xi in (3) contains the terms of
time. No force acts on that coordinate: its row of M, d, f and its column of C are empty, except for a diagonal entry of
M that keeps its acceleration at zero (`STEADY`).
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import casadi as ca

from ..model.doubts import doubt
from ..model.errors import AssemblyError, DeclarationError
from ..model.kinematics import Closing, Kinematics
from ..model.mechanism import Mechanism
from ..model.parts import Body, Coordinate, Friction, Joint, Lock, Marker, Motion, Scalar, key_of, stack, symbolic
from ..model.relations import Relation
from ..model.spatial import SpatialBody
from ..model.stops import EndStop
from ..model.units import rate_of
from . import space
from .closures import closures_of, compliances_of, held_by, relations_of, slips_of, switches_of
from .evaluation import ARGUMENTS, evaluable, shared
from .friction import Rubs, rubbing
from .interface import variables_of
from .loads import efforts_of, inertia_of, is_guided, limited_by, potential_of
from .measures import measures
from .reactions import carried_by, driving, far_of, lengths_of, locking, reach_of, reactions_of, spatial_efforts
from .sums import rearranged
from .types import Equations, Followed, Leap, Row, Variable

_UNGUESSED = 10.0
"""Weight of the change of a coordinate without a guess in the assembly, relative to one with a guess [1]."""

STEADY = 1e-9
"""Diagonal entry of M for time over the mean of masses and inertias [1]: too small to affect any norm of M."""


def derive(mechanism: Mechanism) -> Equations:
    """Return all equations of a mechanism, with names, units and every joint reaction.

    Raises DeclarationError if the declaration has no equations: a body without a position, a joint that no coordinate
    can close, an expression with a foreign symbol.
    """
    m = mechanism
    _check_declared(m)
    at = _symbols(m)
    closed = _closed(m, at)
    terms = _terms(m, at, closed)
    read = _readings(m, at, closed, terms)
    said = _expressions(m, at, closed, terms, read)
    doubt(m, lambda body: m._moves(closed.plain.frame(body).angle) and not is_guided(m, body))
    equations = _equations(m, at, closed, terms, read, said)
    _check_names(m, equations)
    return evaluable(equations)


def _check_declared(m: Mechanism) -> None:
    """Raise DeclarationError if nothing moves, or a body in space is not placed."""
    if not m.coordinates and not m.states and not m.moves:
        raise DeclarationError(f"{m.name}: a mechanism needs at least one coordinate, or a state")
    for body in m.spatial_bodies:
        if not body.is_placed:
            raise DeclarationError(
                f"{m.name}: nothing places {body.name}{m.declared_at(body.name)}, a body in relative coordinates; give "
                "a joint that ends on it its coordinate"
            )
    space.check_points(m)


@dataclass
class _Symbols:
    """The symbols of the equations; q contains time if positions, constraints or energies depend on it."""

    coordinates: Sequence[Coordinate]
    own: tuple[ca.SX, ca.SX]
    """q and v without time."""
    n: int
    """Coordinates without time."""
    q: ca.SX
    v: ca.SX
    a: ca.SX
    t: ca.SX
    begin: ca.SX
    """Time at which the run began."""
    inputs: ca.SX
    u: ca.SX
    """Inputs, then states."""
    s: ca.SX
    """Start values."""
    locks: list[Lock | Motion]
    frictions: list[Friction]
    """Dry frictions that have a lock."""
    kept: list[tuple[str, ca.SX]]
    """Values stored besides those of locks, by name: the time when a run began, numbers of signals."""


def _symbols(m: Mechanism) -> _Symbols:
    coordinates = m.coordinates or (() if m.moves else (_rest(),))
    q, v, a = (stack([getattr(c, letter) for c in coordinates]) for letter in "qva")
    own, n, t = (q, v), q.numel(), m.time
    if m.moves:
        q, t = ca.vertcat(q, m.time), ca.SX.sym("t")
        v, a = (ca.vertcat(x, ca.SX.sym(f"time_{letter}")) for x, letter in ((v, "v"), (a, "a")))
    locks = [c for c in m.closures if isinstance(c, Lock) or (isinstance(c, Motion) and c.value is not None)]
    frictions = [lock for lock in locks if isinstance(lock, Friction)]
    begin = ca.SX.sym("begin")
    kept = [("time", begin), *(("signal", x) for signal in m.signals for x in signal.numbers)] if m.moves else []
    inputs, x = stack([i.symbol for i in m.inputs]), stack([state.symbol for state in m.states])
    s = stack([x.symbol for x in m.starts])
    return _Symbols(coordinates, own, n, q, v, a, t, begin, inputs, ca.vertcat(inputs, x), s, locks, frictions, kept)


@dataclass
class _Closed:
    """Constraints, and the joints and other parts whose directions they close."""

    plain: Kinematics
    held: dict[Joint, tuple[str, ...]]
    rows: list[Row]
    closures: list[Closing]
    signs: ca.SX
    Phi: ca.SX
    lam: ca.SX


def _closed(m: Mechanism, at: _Symbols) -> _Closed:
    plain = Kinematics(m)
    held = held_by(m, plain)
    rows, closures, signs = closures_of(m, held)
    Phi = signs * stack([plain.residual(*c) for c in closures])
    return _Closed(plain, held, rows, closures, signs, Phi, ca.SX.sym("lam", len(rows)))


@dataclass
class _Terms:
    """The terms of (4) and (3), energies and efforts."""

    M: ca.SX
    d: ca.SX
    f: ca.SX
    C: ca.SX
    xi: ca.SX
    T: ca.SX
    V: ca.SX
    f_applied: ca.SX
    """Generalised forces of efforts, without forces of the potential."""
    efforts: ca.SX
    slipping: ca.SX
    """Rows of C without a constraint on positions, of relations that slip."""
    moving: dict[str, ca.SX]
    """Functions of mechanisms that depend on time, by name."""


def _terms(m: Mechanism, at: _Symbols, closed: _Closed) -> _Terms:
    q, v, plain, Phi = at.q, at.v, closed.plain, closed.Phi
    motion, placed = space.SpatialMotion(m, q, v), space.relative_bodies(m)
    M, d, T, W = _inertial(m, at, plain, motion, placed)
    f, f_applied, V, efforts = _loaded(m, at, plain, motion, placed)
    if not m.coordinates and not m.moves:
        M = ca.SX.eye(1)
    C = ca.jacobian(Phi, at.own[0])
    slips, slipping = slips_of(plain, closed.closures, q, v, at.own[1])
    C += slipping
    _check_held_or_heavy(m, plain, M, C)
    xi = -ca.jtimes(ca.jtimes(Phi, q, v) + slips, q, v)  # (3)
    moving: dict[str, ca.SX] = {}
    if m.moves:
        moving["Phi_dot"] = ca.jtimes(Phi, q, v) + slips
        moving["motion_power"] = _motion_power(M, d, T, V, moving["Phi_dot"], f_applied, (q, v, at.a), closed.lam)
        M, d, f, C = _with_time(M, d, f, C, ca.diag(W))
    if m.laws:
        moving["laws"] = _laws(m, q, v)
    return _Terms(M, d, f, C, xi, T, V, f_applied, efforts, slipping, moving)


def _inertial(
    m: Mechanism, at: _Symbols, plain: Kinematics, motion: space.SpatialMotion, placed: list[SpatialBody]
) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """Return M, d and the kinetic energy of bodies and general terms, and the weights of displacements."""
    q, v, own, n = at.q, at.v, at.own, at.n
    X, W = inertia_of(m, plain, pivoted=True)
    Xq = ca.jacobian(X, own[0])
    Xv = ca.jtimes(X, q, v)
    bias = ca.jtimes(Xv, q, v)
    M = Xq.T @ W @ Xq
    d = Xq.T @ (W @ bias)
    T = ca.dot(W @ Xv, Xv) / 2
    if placed:
        carried = motion.mass_matrix(placed)
        M, d = M + carried[:n, :n], d + motion.along(motion.inertial(placed))[:n]
        T += ca.dot(v, carried @ v) / 2
    if m.kinetic:
        extra = sum(m.kinetic, ca.SX(0))
        momentum = ca.gradient(extra, own[1])
        M += ca.jacobian(momentum, own[1])
        d += ca.jtimes(momentum, q, v) - ca.gradient(extra, own[0])
        T += extra
    return M, d, T, W


def _loaded(
    m: Mechanism, at: _Symbols, plain: Kinematics, motion: space.SpatialMotion, placed: list[SpatialBody]
) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """Return f, the part of it due to efforts, the potential, and the efforts along their paths."""
    V = potential_of(m, plain)
    paths, efforts = efforts_of(m, plain, at.q, at.v)
    f_applied = ca.jacobian(paths, at.q).T @ efforts
    if m.spatial_loads:
        f_applied += motion.along(space.loads(m))
    place = {key_of(c.q): i for i, c in enumerate(m.coordinates)}
    for coordinate, expression in m.generalized:
        f_applied[place[key_of(coordinate)]] += expression
    f = f_applied - ca.gradient(V, at.q)
    if placed:
        f += motion.along(space.gravity(m, placed))
        V -= sum((body.mass * ca.dot(stack(m.gravity_vector), body.position) for body in placed), ca.SX(0))
    return f, f_applied, V, efforts


@dataclass
class _Readings:
    """All readable quantities, in the order of the outputs."""

    values: list[Scalar] = field(default_factory=list)
    outputs: list[Variable] = field(default_factory=list)
    wrapped: dict[str, int] = field(default_factory=dict)
    """Angles known up to whole turns, and the start value that determines their turns."""
    borne: list[tuple[ca.SX, Variable]] = field(default_factory=list)
    """Reactions of joints, and all outputs of joints in space."""
    rubs: Rubs = field(default_factory=Rubs)
    limits: list[tuple[ca.SX, EndStop]] = field(default_factory=list)
    """Displacement beyond each limit of each stop."""

    def add(self, values: Sequence[Scalar], outputs: Sequence[Variable]) -> None:
        self.values += values
        self.outputs += outputs


def _readings(m: Mechanism, at: _Symbols, closed: _Closed, terms: _Terms) -> _Readings:
    read, plain = _Readings(), closed.plain
    read.add(*_body_outputs(m, plain, at.q, at.v, at.a))
    for body in m.bodies:
        if plain.frame(body).wrapped:
            read.wrapped[f"{body.name}.angle"] = _tied_start(m, plain.frame(body).angle)
    _read_reactions(read, m, at, closed, terms)
    for joint in m.spatial_joints:
        for which in joint.freedoms:
            if joint.is_wrapped(which):
                read.wrapped[f"{joint.name}.{which}"] = _tied_start(m, joint.counted(which))
    read.add(*_watched(m, plain, at.q, at.v))
    measured_values, measured_outputs, angles = measures(m, plain, at.q, at.v, at.a)
    read.add(measured_values, measured_outputs)
    for hinge in (j for j in m.joints if f"{j.name}.angle" in angles):
        if plain.frame(hinge.first.body).wrapped or plain.frame(hinge.second.body).wrapped:
            read.wrapped[f"{hinge.name}.angle"] = _tied_start(m, angles[f"{hinge.name}.angle"])
    _read_declared(read, m, at, closed)
    return read


def _read_reactions(read: _Readings, m: Mechanism, at: _Symbols, closed: _Closed, terms: _Terms) -> None:
    """Add reactions of joints, efforts of relations, locks, motions and dry friction."""
    q, v, a, lam, plain, closures = at.q, at.v, at.a, closed.lam, closed.plain, closed.closures
    relations = relations_of(m, closures, lam)
    reactions, reaction_outputs = reactions_of(m, plain, closed.held, q, v, a, terms.efforts, lam, relations)
    read.add(reactions, reaction_outputs)
    for relation, its in relations:
        for suffix, value, unit, text in relation.readings(plain, its):
            read.add([value], [Variable(f"{relation.name}.{suffix}", unit, description=text)])
    loads = {o.name: r for o, r in zip(reaction_outputs, reactions, strict=True)}
    plain_locks = [x for x in at.locks if x not in at.frictions]
    for efforts_kept, kept_outputs in (locking(plain_locks, closures, lam), driving(closures, lam)):
        read.add(efforts_kept, kept_outputs)
    rows_of_locks = {x: closures.index((x, x.direction)) for x in at.locks if isinstance(x, Lock)}
    efforts_in_space = spatial_efforts(m, plain, q, v)
    spatial_values, spatial_outputs = space.outputs(m, q, v, a, closures, lam, efforts_in_space)
    loads |= {o.name: x for o, x in zip(spatial_outputs, spatial_values, strict=True)}
    read.borne = [
        *zip(reactions, reaction_outputs, strict=True),
        *zip(spatial_values, spatial_outputs, strict=True),
    ]
    read.rubs = rubbing(at.locks, rows_of_locks, plain.free, loads, (q, v, a), lam)
    read.add(read.rubs.values, read.rubs.outputs)
    read.add(spatial_values, spatial_outputs)


def _read_declared(read: _Readings, m: Mechanism, at: _Symbols, closed: _Closed) -> None:
    """Add multipliers, states, declared outputs, and limit stops."""
    read.values += ca.vertsplit(closed.lam)
    for i, row in enumerate(closed.rows):
        force = "N" if row.unit == "m" else "N.m"  # reaction times row is work
        text = f"multiplier of {row.name}, {row.what}"
        read.outputs.append(Variable(f"multiplier[{i + 1}]", force, description=text))
    read.add([state.symbol for state in m.states], _states(m))
    read.add(
        [o.expression for o in m.outputs], [Variable(o.name, o.unit, description=o.description) for o in m.outputs]
    )
    for stop in m.end_stops:
        x = limited_by(closed.plain, stop)
        read.limits += [(depth, stop) for depth, _ in stop.penetrations(x)]
        what, unit = ("force", "N") if stop.unit == "m" else ("torque", "N.m")
        read.values += [stop.penetration(x), stop.effort(x, ca.jtimes(x, at.q, at.v))]
        read.outputs.append(
            Variable(f"{stop.name}.penetration", stop.unit, description=f"how far {stop.limited} is in {stop.name}")
        )
        read.outputs.append(
            Variable(f"{stop.name}.{what}", unit, description=f"{what} of {stop.name} on {stop.limited}")
        )


def _states(m: Mechanism) -> list[Variable]:
    return [Variable(x.name, x.unit, x.start, description=x.description, nominal=x.nominal) for x in m.states]


@dataclass
class _Expressions:
    """Expressions of all functions of the equations, by name."""

    of: dict[str, ca.SX]
    symbols: dict[str, ca.SX]
    """Arguments of the functions."""
    counted: dict[str, tuple[ca.SX, ca.SX, int]]
    """Angles whose turns a run counts: their last value, the angle, and the start value near which it begins."""
    tied: list[int]
    """Start values that are tied."""


def _expressions(m: Mechanism, at: _Symbols, closed: _Closed, terms: _Terms, read: _Readings) -> _Expressions:
    own, plain, lam, f_applied = at.own, closed.plain, closed.lam, terms.f_applied
    gaps = closed.signs * stack([plain.gap(*c) for c in closed.closures])
    y = stack(read.values)
    carried, weights = carried_by(m, read.borne, closed.closures, lam, lengths_of(m, closed.rows))
    guess = _without_turns(m, _guess(m, at.coordinates, at.begin))
    sdot = ca.SX.sym("sdot", len(m.starts))
    tied, ties = _ties(m)
    passive = ca.substitute(f_applied, at.u, ca.SX.zeros(at.u.shape)) if at.u.numel() else f_applied
    of_motion = [terms.M, terms.d, terms.f, closed.Phi, terms.C, terms.xi, terms.V, terms.T, _state_rates(m)]
    counted = _counted(m, plain, [y, *of_motion, *read.rubs.functions.values()])
    nears = [near for near, _, _ in counted.values()]
    values = [x.value for x in at.locks if x.value is not None]
    remembered = [*values, *(x.slip for x in at.frictions), *nears, *(x for _, x in at.kept)]
    p = stack([x.symbol for x in m.parameters] + remembered)
    symbols = {"q": at.q, "v": at.v, "a": at.a, "lam": lam, "u": at.u, "p": p, "t": at.t, "s": at.s, "sdot": sdot}
    expressions = {
        "M": terms.M,
        "d": terms.d,
        "f": terms.f,
        "Phi": closed.Phi,
        "C": terms.C,
        "xi": terms.xi,
        "displacements": stack(
            [
                *(plain.locked(lock)[0] for lock in at.locks),
                *(x.slip for x in at.frictions),
                *(angle for _, angle, _ in counted.values()),
                *(0.0 for _ in at.kept),
            ]
        ),
        **({"counted": stack([angle for _, angle, _ in counted.values()])} if counted else {}),
        "gaps": gaps,
        "gaps_matrix": ca.horzcat(ca.jacobian(gaps, own[0]) + terms.slipping, ca.SX(gaps.numel(), int(m.moves))),
        "kinetic_energy": terms.T,
        "potential_energy": terms.V,
        "input_power": ca.dot(f_applied - passive, at.v),
        "other_power": ca.dot(passive, at.v),
        "state_rates": _state_rates(m),
        "readings": y,
        "shares": ca.gradient(ca.dot(weights * carried, carried) / 2, lam) if lam.numel() else lam,
        **read.rubs.functions,
        **({"instants": stack(m.instants)} if m.instants else {}),
        **({"stops": stack([x for x, _ in read.limits])} if read.limits else {}),
        "guess": guess,
        "guess_rate": (ca.jtimes(guess, at.s, sdot) if m.starts else ca.SX.zeros(guess.shape))
        + (ca.jacobian(guess, at.begin) if m.moves else 0),
        "ties": ties,
        "ties_matrix": ca.jacobian(ties, at.q),
        **terms.moving,
    }
    return _Expressions(expressions, symbols, counted, tied)


def _equations(
    m: Mechanism, at: _Symbols, closed: _Closed, terms: _Terms, read: _Readings, said: _Expressions
) -> Equations:
    """Return the equations: functions with names and units of their arguments and results."""
    locks, frictions, closures, plain, counted = at.locks, at.frictions, closed.closures, closed.plain, said.counted
    guessed = any(c.guessed and not m._is_start(symbolic(c.guess)) for c in at.coordinates)
    instant = _depends_on_any(stack(read.values), ca.vertcat(at.a, closed.lam, at.inputs))
    guess = [said.symbols[letter] for letter in ARGUMENTS["guess"]]
    far = far_of(m, ca.Function("guess", guess, [said.of["guess"]]))
    places = {
        "q": [i for i, c in enumerate(m.coordinates) if c.unit == "m"],
        "p": [i for i, x in enumerate(m.parameters) if x.unit == "m" and abs(x.default) >= far],
    }
    return Equations(
        name=m.name,
        description=m.description,
        coordinates=[
            *(
                Variable(c.name, c.unit, readiness=1.0 if c.guessed or not guessed else _UNGUESSED)
                for c in at.coordinates
            ),
            *[Variable("time", "s")] * m.moves,
        ],
        parameters=[Variable(x.name, x.unit, x.default, x.minimum, x.maximum, x.description) for x in m.parameters],
        starts=[Variable(f"start.{x.name}", x.unit, x.value, description=x.description) for x in m.starts],
        start_rates=[
            Variable(f"start.{x.rate_name}", rate_of(x.unit), x.rate, description=f"rate of start.{x.name}")
            for x in m.starts
        ],
        tied=said.tied,
        inputs=[Variable(i.name, i.unit, i.start, description=i.description) for i in m.inputs],
        states=_states(m),
        resting=not m.coordinates and not m.moves,
        outputs=[Variable(**{**o.__dict__, "instant": i}) for o, i in zip(read.outputs, instant, strict=True)],
        rows=closed.rows,
        lengths=lengths_of(m, closed.rows),
        slips=[i for i, (c, k) in enumerate(closures) if isinstance(c, Relation) and c.slip(plain, k) is not None],
        compliances=compliances_of(closed.rows) if m.compliant else [],
        switches=switches_of(m, locks, closures),
        frictions=read.rubs.frictions,
        held=[
            *(lock.name for lock in locks),
            *(f"{x.name}.slip" for x in frictions),
            *counted,
            *(name for name, _ in at.kept),
        ],
        counted={name: start for name, (_, _, start) in counted.items()},
        timed=m.moves,
        followed=_followed(m),
        leaps=_leaps(m, closures),
        limited=[Variable(stop.name, stop.unit) for _, stop in read.limits],
        wrapped=read.wrapped,
        reach=reach_of(m),
        works=m.moves or bool(frictions) or not terms.f_applied.is_zero(),
        stop_time=m.experiment.stop_time,
        step_size=m.experiment.step_size,
        interval=m.experiment.communication_step or m.experiment.step_size,
        options=m.options,
        functions={name: _function(m, name, said.symbols, x, far, places) for name, x in said.of.items()},
    )


def _rest() -> Coordinate:
    """Return the coordinate for a mechanism of states alone: a mass of 1 without forces."""
    q, v, a = (ca.SX.sym(f"rest_{letter}") for letter in "qva")
    return Coordinate("rest", q, v, a, "m", 0.0)


def _state_rates(m: Mechanism) -> ca.SX:
    """Return time derivatives of the states; raise DeclarationError if one is not declared."""
    rates = []
    for state in m.states:
        if state.rate is None:
            raise DeclarationError(
                f"{m.name}: the state {state.name} has no rate{m.declared_at(state.name)}; give one, in state() or in "
                "derivative()"
            )
        rates.append(state.rate)
    return stack(rates)


def _motion_power(
    M: ca.SX,
    d: ca.SX,
    T: ca.SX,
    V: ca.SX,
    Phi_dot: ca.SX,
    f_applied: ca.SX,
    motion: tuple[ca.SX, ca.SX, ca.SX],
    lam: ca.SX,
) -> ca.SX:
    """Return power [W] of prescribed motion, on the motion of (4): the rate of the energies less the power of efforts.

    There v' (M a + d - f) = -v' C' lam = Phi_t' lam, so this power is that of multipliers, plus the explicit time
    derivatives of T and V.
    """
    q, v, a = motion
    n, time, rate = M.shape[0], q[-1], v[-1]
    power = -f_applied[n] * rate
    if lam.numel():
        power += ca.dot(ca.jacobian(Phi_dot, rate), lam) * rate
    if ca.depends_on(ca.vertcat(T, V), ca.vertcat(time, rate)):
        power += ca.jtimes(T, v, a) + ca.jtimes(T, q, v) + ca.jacobian(V, time) * rate
        if n:
            power -= ca.dot(v[:n], M @ a[:n] + d)
    return power


def _with_time(M: ca.SX, d: ca.SX, f: ca.SX, C: ca.SX, w: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """Return the terms of (4) and (3) with time as the last coordinate, on which no force acts."""
    n = M.shape[0]
    size = STEADY * (ca.sum1(w) / w.numel() if w.numel() and not w.is_zero() else 1)
    return (
        ca.diagcat(M, size),
        ca.vertcat(d, 0),
        ca.vertcat(*ca.vertsplit(f)[:n], 0),
        ca.horzcat(C, ca.SX(C.shape[0], 1)),
    )


def _counted(m: Mechanism, places: Kinematics, expressions: Sequence[ca.SX]) -> dict[str, tuple[ca.SX, ca.SX, int]]:
    """Return the angles whose turns a run counts because something depends on them: by name, last value, angle, and
    start value near which it begins."""
    known = [
        (f"{body.name}.angle", body.near, (frame := places.frame(body)).counted, frame.angle)
        for body in _between_points(m)
    ]
    if known:
        hinges = (joint for joint in m.joints if joint.kind == "revolute")
        known += [(f"{x.name}.angle", x.near, places.counted(x), places.free(x)) for x in hinges]
    for joint in m.spatial_joints:
        for x in (x for x in joint.freedoms if joint.is_wrapped(x)):
            known += [(f"{joint.name}.{x}", joint.near(x), joint.counted(x), joint.counted(x))]
    used = {key_of(symbol) for symbol in ca.symvar(ca.veccat(*expressions))} if known else set()
    return {name: (near, x, _tied_start(m, plain)) for name, near, x, plain in known if key_of(near) in used}


def _between_points(m: Mechanism) -> list[Body]:
    """Return bodies placed by two points."""
    return [body for body in m.bodies if body.between is not None]


def _without_turns(m: Mechanism, x: ca.SX) -> ca.SX:
    """Return an expression with its angles as they are before a run has counted turns."""
    nears = [body.near for body in _between_points(m)]
    nears += [joint.near(which) for joint in m.spatial_joints for which in joint.freedoms if joint.is_wrapped(which)]
    return ca.substitute(x, stack(nears), ca.SX.zeros(len(nears))) if nears else x


def _followed(m: Mechanism) -> list[Followed]:
    """Return the extrapolation of inputs that prescribe motion; raise DeclarationError if companions of other inputs do
    nothing."""
    places = {i.name: k for k, i in enumerate(m.inputs)}
    for each in m.inputs:
        if each.derivatives and not any(signal.input is each for signal in m.signals):
            raise DeclarationError(
                f"{m.name}: the input {each.name} has derivatives and prescribes no motion{m.declared_at(each.name)}; "
                "leave derivatives out, or use it in a motion, a place or a constraint"
            )
    return [Followed(places[x.name], x.derivatives, x.order, x.jump) for x in (signal.input for signal in m.signals)]


def _laws(m: Mechanism, q: ca.SX, v: ca.SX) -> ca.SX:
    """Return laws that may jump or diverge, and their first and second rates at constant velocities."""
    laws = stack([law.value for law in m.laws])
    rates = ca.jtimes(laws, q, v)
    return ca.vertcat(laws, rates, ca.jtimes(rates, q, v))


def _leaps(m: Mechanism, closures: Sequence[Closing]) -> list[Leap]:
    """Return the laws whose jumps a run reports; a switchable one applies while its constraint is in force."""
    rows = {c.name: i for i, (c, direction) in enumerate(closures) if direction == "motion"}
    return [Leap(law.what, law.unit, rows[law.motion] if law.motion else -1) for law in m.laws]


def _check_held_or_heavy(m: Mechanism, kinematics: Kinematics, M: ca.SX, C: ca.SX) -> None:
    """Check that every coordinate moves a mass or is in a constraint, for any parameters."""
    masses = ca.sparsify(M)
    there = {*masses.sparsity().get_triplet()[1], *C.sparsity().get_triplet()[1]}
    free = [c for i, c in enumerate(m.coordinates) if i not in there]
    if not free and not masses.nnz() and ca.sprank(C.sparsity()) < C.size2():
        free = [*m.coordinates]
    if free:
        q = stack([c.q for c in free])
        poses = {body: ca.vertcat(*kinematics.center(body), kinematics.frame(body).angle) for body in m.bodies}
        bodies = [f"{b.name}{m.declared_at(b.name)}" for b, pose in poses.items() if ca.depends_on(pose, q)]
        bodies += [f"{b.name}{m.declared_at(b.name)}" for b in m.spatial_bodies if ca.depends_on(b.position, q)]
        along = ", ".join(c.name for c in free)
        moves = f"it moves {', '.join(bodies)}" if bodies else "it moves no body"
        raise AssemblyError(
            f"{m.name}: the motion along {along} has no mass and no constraint that holds it; {moves}: give a mass (an "
            "inertia where it turns alone), or constraints at both ends of a massless body: "
            "never the last body of an open chain"
        )


def _check_names(m: Mechanism, equations: Equations) -> None:
    """Raise DeclarationError if a user's name is that of a derived variable."""
    found: dict[str, Variable] = {}
    for _, v in variables_of(equations).causalities:
        if v.name in found:
            what = found[v.name].description or v.description
            raise DeclarationError(
                f"{m.name}: {v.name!r} is the name of a derived variable ({what}){m.declared_at(v.name)}; take "
                "another name"
            )
        found[v.name] = v


def _function(
    m: Mechanism, name: str, symbols: dict[str, ca.SX], value: ca.SX, far: float, places: dict[str, list[int]]
) -> ca.Function:
    arguments = [symbols[letter] for letter in ARGUMENTS[name]]
    value = ca.densify(value) if value.is_column() else value
    function = ca.Function(name, arguments, [value], {"allow_free": True})
    if function.has_free():
        free = ", ".join(map(str, function.get_free()))
        raise DeclarationError(
            f"{m.name}: {name} uses {free}, which is no coordinate, rate, parameter or input of this mechanism; "
            "declare it here"
        )
    if far:
        own = {(k, i) for k, letter in enumerate(ARGUMENTS[name]) for i in places.get(letter, ())}
        value = rearranged(arguments, value, far, own)
    return shared(name, arguments, [value])


def _body_outputs(
    m: Mechanism, kinematics: Kinematics, q: ca.SX, v: ca.SX, a: ca.SX
) -> tuple[list[ca.SX], list[Variable]]:
    """Return position, velocity and acceleration of centres of mass and angles, and of sliders along their guides."""
    names: list[tuple[str, str, str, str, str]] = []
    places: list[Scalar] = []
    for body in m.bodies:
        frame = kinematics.frame(body)
        places += [*kinematics.center(body), frame.angle]
        b = body.name
        names += [
            (f"{b}.x", f"{b}.vx", f"{b}.ax", "m", f"{{}} of the centre of mass of {b} along x"),
            (f"{b}.y", f"{b}.vy", f"{b}.ay", "m", f"{{}} of the centre of mass of {b} along y"),
            (f"{b}.angle", f"{b}.angular_velocity", f"{b}.angular_acceleration", "rad", f"angular {{}} of {b}"),
        ]
    sliders = [j for j in m.joints if j.kind == "prismatic"]
    guides = Counter(j.second.body for j in sliders)
    for joint in sliders:
        b = joint.second.body.name
        if guides[joint.second.body] == 1:
            places.append(kinematics.free(joint))
            along = f"{{}} of {b} along {joint.name}"
            names.append((f"{b}.position", f"{b}.velocity", f"{b}.acceleration", "m", along))
    X = stack(places)
    Xv = ca.jtimes(X, q, v)
    Xa = ca.jtimes(Xv, q, v) + ca.jtimes(X, q, a)
    values: list[ca.SX] = []
    outputs: list[Variable] = []
    for place in zip(*map(ca.vertsplit, (X, Xv, Xa)), strict=True):
        values += place
    for x, xv, xa, unit, text in names:
        rate, second = rate_of(unit), rate_of(rate_of(unit))
        word = "position" if unit == "m" else "place"
        for name, name_unit, what in ((x, unit, word), (xv, rate, "velocity"), (xa, second, "acceleration")):
            outputs.append(Variable(name, name_unit, description=text.format(what).replace("angular place", "angle")))
    return values, outputs


def _watched(m: Mechanism, kinematics: Kinematics, q: ca.SX, v: ca.SX) -> tuple[list[ca.SX], list[Variable]]:
    """Return position and velocity of every watched point."""
    values: list[ca.SX] = []
    outputs: list[Variable] = []
    for point in m.watched:
        marker = point.marker
        place = ca.vertcat(*kinematics.place(marker)) if isinstance(marker, Marker) else marker.place
        what = point.description or f"{point.name}, a point of {marker.body.name},"
        for letter, unit, word, vector in (("", "m", "place", place), ("v", "m/s", "velocity", ca.jtimes(place, q, v))):
            for axis, x in zip(point.axes, ca.vertsplit(vector), strict=True):
                values.append(x)
                outputs.append(
                    Variable(f"{point.name}.{letter}{axis}", unit, description=f"{word} of {what} along {axis}")
                )
    return values, outputs


def _guess(m: Mechanism, coordinates: Sequence[Coordinate], begin: ca.SX) -> ca.SX:
    """Return guesses of the coordinates in parameters, start values and the time at which the run begins."""
    resolved: dict[int | None, ca.SX] = {}
    for c in coordinates:
        guess = symbolic(c.guess)
        before = [symbol for symbol in ca.symvar(guess) if key_of(symbol) in resolved]
        if before:
            guess = ca.substitute(guess, stack(before), stack([resolved[key_of(b)] for b in before]))
        resolved[key_of(c.q)] = guess
    guess = stack(list(resolved.values()))
    return ca.vertcat(ca.substitute(guess, m.time, begin), begin) if m.moves else guess


def _ties(m: Mechanism) -> tuple[list[int], ca.SX]:
    """Return the start quantity of each tie, and the ties; a computed angle is compared up to whole turns."""
    tied, residuals = [], []
    place = {key_of(x.symbol): i for i, x in enumerate(m.starts)}
    for symbol, expression in m.ties:
        i = place[key_of(symbol)]
        difference = _without_turns(m, expression - symbol)
        if m.starts[i].unit == "rad" and not expression.is_symbolic():
            difference = ca.atan2(ca.sin(difference), ca.cos(difference))
        tied.append(i)
        residuals.append(difference)
    return tied, stack(residuals)


def _tied_start(m: Mechanism, angle: ca.SX) -> int:
    """Return the start quantity near which a computed angle begins, -1 if there is none."""
    for symbol, expression in m.ties:
        if (expression - angle).is_zero() or ca.is_equal(_without_turns(m, expression), _without_turns(m, angle), 12):
            return next(k for k, x in enumerate(m.starts) if key_of(x.symbol) == key_of(symbol))
    return -1


def _depends_on_any(y: ca.SX, x: ca.SX) -> list[bool]:
    """Return which entries of y depend on any entry of x."""
    touched = set(ca.jacobian_sparsity(y, x).row())
    return [i in touched for i in range(y.numel())]
