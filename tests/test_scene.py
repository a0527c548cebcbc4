"""Scenes as files: functions interpreted in C give the bits of CasADi, as straight code, in loops and compiled; damaged
files are refused.

`DRAWS=12 pytest tests/test_scene.py` draws so many random functions of each kind; by default three.
"""

import ctypes
import re
import subprocess
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from pairs import draws
from scenes import derived
from sines import by_instructions

import alfmu
from alfmu.equations import Equations, Variable
from alfmu.equations.evaluation import with_functions
from alfmu.kernel import passes, stream, tables
from alfmu.kernel import scene as file
from alfmu.kernel.complete import FUNCTIONS, complete
from alfmu.kernel.form import Call, Lanes, Program, Steps
from alfmu.kernel.memory import Layout
from alfmu.kernel.passes import Code, in_line, written
from alfmu.kernel.scene import Writer, operations_header
from alfmu.kernel.stream import Instructions
from alfmu.runtime import compiled as build
from alfmu.simulation import prepared

CORE = Path(alfmu.__file__).parent / "runtime" / "c" / "core"
HOST = Path(__file__).with_name("scene_host.c")
SOURCES = [HOST, *sorted(CORE.glob("*.c"))]
STRICT = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", *build.FLAGS, f"-I{CORE}"]

N = 60

DRAWS = range(draws(3))

pytestmark = pytest.mark.skipif(not build.compiler(), reason="there is no C compiler")


class Host:
    """Scenes loaded by the C runtime."""

    def __init__(self, path: Path):
        self._library = ctypes.CDLL(str(path))
        self._library.host_load.restype = ctypes.c_void_p

    def load(self, scene: bytes) -> ctypes.c_void_p:
        why = ctypes.create_string_buffer(300)
        found = self._library.host_load(scene, ctypes.c_size_t(len(scene)), why, ctypes.c_size_t(len(why)))
        if not found:
            raise ValueError(why.value.decode())
        return ctypes.c_void_p(found)

    def count(self, scene: ctypes.c_void_p) -> int:
        return self._library.host_shape(scene, 0, ctypes.byref(ctypes.c_int()))

    def wide(self, scene: ctypes.c_void_p, which: int) -> bool:
        wide = ctypes.c_int()
        self._library.host_shape(scene, which, ctypes.byref(wide))
        return bool(wide.value)

    def call(self, scene: ctypes.c_void_p, which: int, f: ca.Function, x: Sequence[NDArray]) -> NDArray:
        """The nonzeros of all results of a function, one result behind the other."""
        given = np.concatenate([*x, [0.0]])
        y = np.full(sum(f.nnz_out(i) for i in range(f.n_out())) + 1, np.nan)
        assert self._library.host_call(scene, which, *map(address, (given, y)))
        return y[:-1]

    def run(self, scene: ctypes.c_void_p, quick: bool, memory: NDArray) -> NDArray:
        """The memory and the workspace after a program."""
        made = np.zeros(self._library.host_length(scene))
        made[: len(memory)] = memory
        assert self._library.host_run(scene, int(quick), address(made))
        return made

    def replace(self, scene: ctypes.c_void_p, path: Path, identity: bytes | None = None, more: int = 0) -> bool:
        """Compiled functions in place of the interpreted ones."""
        library = ctypes.CDLL(str(path))
        count, spare = (ctypes.c_int.in_dll(library, f"alfmu_{x}").value for x in ("function_count", "spare"))
        own = ctypes.string_at(ctypes.addressof(ctypes.c_char.in_dll(library, "alfmu_scene")))
        functions = (ctypes.c_void_p * count).in_dll(library, "alfmu_functions")
        return bool(self._library.host_replace(scene, functions, count + more, spare, identity or own))


def address(values: NDArray) -> ctypes.c_void_p:
    return values.ctypes.data_as(ctypes.c_void_p)


def compiled(path: Path, *flags: str) -> subprocess.CompletedProcess:
    command = [*build.compiler(), *STRICT, *flags, *map(str, SOURCES), "-lm", "-o", str(path)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def host(tmp_path_factory) -> Host:
    path = tmp_path_factory.mktemp("host") / "host.so"
    done = compiled(path, "-O2", "-shared")
    assert done.returncode == 0, done.stderr
    return Host(path)


@pytest.fixture(scope="module")
def small() -> Equations:
    """The smallest scene: no program does anything, and there are no more functions than every scene has."""
    own = complete(prepared(derived("particle_on_circle"), "vm"))
    kernel = {name: replace(program, steps=()) for name, program in own.kernel.items()}
    names = [name for name in FUNCTIONS.values() if name in own.signatures]
    functions, signatures = ({name: x[name] for name in names} for x in (own.functions, own.signatures))
    return replace(own, kernel=kernel, functions=functions, signatures={**signatures, "seen": own.signatures["seen"]})


@pytest.fixture
def packed(small) -> Callable[..., tuple[bytes, int]]:
    """`packed(f, ...)`: a scene with these functions too, and the number of the first of them."""

    def scene(*functions: ca.Function, kernel: Mapping[str, Program] = small.kernel) -> tuple[bytes, int]:
        own = replace(with_functions(small, {f.name(): f for f in functions}), kernel=kernel)
        return tables.packed(own), len(small.functions)

    return scene


@pytest.fixture
def short(monkeypatch) -> None:
    """Every function is searched for what repeats."""
    monkeypatch.setattr(passes, "LONG", 0)
    monkeypatch.setattr(passes, "WORTH", 0.0)


def arguments(f: ca.Function, seed: int = 0) -> list[NDArray]:
    rng = np.random.default_rng(seed)
    return [rng.uniform(0.5, 1.5, f.nnz_in(i)) for i in range(f.n_in())]


def expected(f: ca.Function, x: Sequence[NDArray]) -> NDArray:
    """What CasADi gives, with the runtime's sines and cosines."""
    return np.concatenate([*by_instructions(f, x), []])


def same_bits(a: NDArray, b: NDArray) -> bool:
    """Of all numbers; those that are none may be any."""
    return a.shape == b.shape and bool(((a.view(np.int64) == b.view(np.int64)) | (np.isnan(a) & np.isnan(b))).all())


def code(f: ca.Function) -> Code:
    lengths = ([part(i) for i in range(n)] for part, n in ((f.nnz_in, f.n_in()), (f.nnz_out, f.n_out())))
    return written(Instructions.of(f), *lengths)


def check(host: Host, packed: Callable, *functions: ca.Function) -> None:
    """A scene gives the bits of CasADi for these functions."""
    scene, first = packed(*functions)
    loaded = host.load(scene)
    for k, f in enumerate(functions, first):
        for seed in (0, 1):
            x = arguments(f, seed)
            assert same_bits(host.call(loaded, k, f, x), expected(f, x)), f.name()


# Straight code --------------------------------------------------------------------------------------------------------

UNARY = [ca.fabs, ca.floor, ca.ceil, ca.sqrt, ca.exp, ca.log, ca.sin, ca.cos, ca.tan, ca.asin, ca.acos, ca.atan]
UNARY += [ca.sinh, ca.cosh, ca.tanh, ca.asinh, ca.acosh, ca.atanh, ca.sign, ca.erf, ca.log1p, ca.expm1, ca.logic_not]
UNARY += [lambda a: -a, lambda a: 1 / a, lambda a: 2 * a, lambda a: a * a, lambda a: a**3.5, lambda a: a + 0.1]
BINARY = [ca.fmin, ca.fmax, ca.atan2, ca.fmod, ca.hypot, ca.copysign, ca.remainder, ca.logic_and, ca.logic_or]
BINARY += [lambda a, b: a + b, lambda a, b: a - b, lambda a, b: a * b, lambda a, b: a / b, lambda a, b: a**b]
BINARY += [lambda a, b: a < b, lambda a, b: a <= b, lambda a, b: a == b, lambda a, b: a != b]
BINARY += [lambda a, b: ca.if_else(a < b, a, b)]


def test_headers_are_those_of_the_tables():
    assert (CORE / "operations.h").read_text() == operations_header()
    assert (CORE / "layout.h").read_text() == tables.layout_header()


def test_instructions_are_those_that_casadi_tells_one_by_one():
    """As they stand in its listing, which is far faster to read."""
    f = random_function(np.random.default_rng(3), 500)
    found = stream._listed(f)
    for read, told in zip(found, stream._one_by_one(f), strict=True):
        unary = told[0] in stream.UNARY
        assert read[: 3 if unary else 4].tolist() == told[: 3 if unary else 4].tolist()


def test_instructions_are_told_one_by_one_where_the_listing_has_another_form(monkeypatch):
    f = random_function(np.random.default_rng(3), 500)
    one = Instructions.of(f)
    told = ca.Function.str
    for wrong in ("", "@0 = 1;", "@0 = @1 = @2 = @3;\n"):
        monkeypatch.setattr(ca.Function, "str", lambda f, more, wrong=wrong: f"f\nAlgorithm:\n{wrong}")
        assert stream._listed(f) is None
    monkeypatch.setattr(ca.Function, "str", lambda f, more: told(f, more).replace("@", "$"))
    two = Instructions.of(f)
    for name in ("code", "operands", "place"):
        assert np.array_equal(getattr(one, name), getattr(two, name))
    assert same_bits(one.constant, two.constant)


def test_operations_that_look_alike_in_a_listing_are_told_apart(monkeypatch):
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    f = ca.Function("f", [x, y], [x - y, x + y, (x + y) * y, ca.sin(x), ca.cos(x * y), x**y, x**1.5])
    told = ca.Function.str
    monkeypatch.setattr(ca.Function, "str", lambda f, more: told(f, more).replace("+", "-").replace("sin", "cos"))
    monkeypatch.setattr(stream, "_FORMS", {0: ca.OP_CONST})
    stream._alike.cache_clear()
    assert np.array_equal(stream._listed(f)[:, 0], [f.instruction_id(k) for k in range(f.n_instructions())])
    stream._alike.cache_clear()


def random_function(rng: np.random.Generator, count: int) -> ca.Function:
    """Operations of all kinds on what came before, of which each may be used often or never; but which of two zeros of
    either sign is the lesser, C leaves open."""
    x, p = ca.SX.sym("x", 5), ca.SX.sym("p")
    values = [*ca.vertsplit(x), p, ca.SX(0.3), ca.SX(-0.0), ca.SX(ca.inf)]
    for _ in range(count):
        near = rng.integers(max(0, len(values) - 40), len(values), 2).tolist()
        a, b = (values[i] for i in near)
        if rng.random() < 0.25:
            made = UNARY[rng.integers(len(UNARY))](a)
        else:
            made = BINARY[rng.integers(9, len(BINARY)) if rng.random() < 0.7 else rng.integers(2, 9)](a, b)
        # What became huge, tiny or no number would hide everything after it.
        values.append(made if rng.random() < 0.3 else ca.fmin(ca.fmax(made, -3.0), 3.0))
    chosen = [values[i] for i in rng.integers(0, len(values), 60).tolist()]
    return ca.Function(f"f{count}", [x, p], [ca.vertcat(*chosen[:30], 0.0, x[1], 2.5), ca.vertcat(*chosen[30:])])


@pytest.mark.slow
def test_every_operation_gives_the_bits_of_casadi(host, packed):
    x = ca.SX.sym("x", 2)
    a, b = ca.vertsplit(x)
    f = ca.Function("f", [x], [ca.vertcat(*(g(a) for g in UNARY), *(g(a, b) for g in BINARY))])
    used = {f.instruction_id(k) for k in range(f.n_instructions())} - {ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST}
    assert used >= (set(stream.BINARY) | set(stream.UNARY)) - {ca.OP_ASSIGN, ca.OP_CONSTPOW}
    scene, first = packed(f)
    loaded = host.load(scene)
    signs = ((0.9, -0.4), (-0.0, 0.5), (0.5, -0.0))
    for values in ((0.3, 0.7), (0.7, 0.3), (0.5, 0.5), *signs, (1.5, -np.inf), (np.nan, 1.0)):
        given = [np.array(values)]
        assert same_bits(host.call(loaded, first, f, given), expected(f, given)), values


@pytest.mark.slow
@pytest.mark.parametrize("seed", DRAWS)
def test_random_functions_give_the_bits_of_casadi(host, packed, seed):
    rng = np.random.default_rng(seed)
    check(host, packed, *(random_function(rng, count) for count in (3, 40, 300, 2000)))


@pytest.mark.slow
def test_places_have_16_bits_where_they_suffice_and_32_beyond(host, packed):
    """Beyond, by as many arguments, of which the first and last that have 16 bits are used, and those after them."""
    few, x = random_function(np.random.default_rng(0), 300), ca.SX.sym("x", 70000)
    many = ca.Function("many", [x], few.call([x[[0, 2**16 - 2, 2**16 - 1, 2**16, 69999]], x[40000]]))
    scene, first = packed(few, many)
    loaded = host.load(scene)
    assert [host.wide(loaded, first + k) for k in (0, 1)] == [False, True]
    for k, f in enumerate((few, many)):
        x = arguments(f)
        assert same_bits(host.call(loaded, first + k, f, x), expected(f, x))


def test_the_sine_of_an_angle_may_stand_twice(host, packed):
    x = ca.SX.sym("x")
    f = ca.Function("f", [x], [ca.vertcat(ca.sin(x), ca.sin(x) + 1, ca.cos(x), ca.sin(x) * ca.sin(x))], {"cse": False})
    check(host, packed, f)


# Loops ----------------------------------------------------------------------------------------------------------------


def test_values_in_line_are_told_by_few_numbers():
    assert in_line(np.array([3, 5, 7, 7, 7, 1])) == [(3, 3, 2), (2, 7, 0), (1, 1, 0)]
    assert in_line(np.array([4])) == [(1, 4, 0)]
    assert in_line(np.array([], int)) == []
    rng = np.random.default_rng(0)
    for _ in range(200):
        steps = rng.integers(-2, 3, rng.integers(1, 40))
        values = np.repeat(steps, rng.integers(1, 5, len(steps))).cumsum()
        other = rng.integers(0, 2, len(values)).cumsum()
        rows = in_line(values, other)
        made = [(a + i * s, b + i * t) for count, a, s, b, t in rows for i in range(count)]
        assert made == list(zip(values.tolist(), other.tolist(), strict=True))


def chain(length: int) -> ca.Function:
    """Down a chain and back up, as a banded matrix is solved."""
    x = ca.SX.sym("x", length)
    down, up = [x[0]], []
    for i in range(1, length):
        down.append(x[i] / (4 - down[-1]) + ca.sin(x[i - 1]))
    for i in reversed(range(length)):
        up.append(down[i] - (0.3 * up[-1] if up else 0))
    return ca.Function("chain", [x], [ca.vertcat(*up)])


def shapes() -> dict[str, Callable[[ca.SX, ca.SX], list]]:
    """Ways in which passes depend on each other, and on what is elsewhere."""
    order = np.random.default_rng(0).permutation(N).tolist()
    back = np.random.default_rng(0).integers(1, 4, N).tolist()

    def each(x, p):
        return [ca.sin(x[i]) * p + x[i] for i in range(N)]

    def constants(x, p):
        return [(x[i] + 0.1 * (i + 1) ** 2) * 7.5 - p for i in range(N)]

    def out_of_line(x, p):
        return [ca.cos(x[i]) * x[j] + p for i, j in enumerate(order)]

    def sums(x, p):
        total, made = p, []
        for i in range(N):
            total = total + x[i] * x[i] - 0.5
            made.append(ca.sqrt(total * total))
        return made

    def two_back(x, p):
        made = [x[0], x[1] * p]
        for i in range(2, N):
            made.append(0.5 * made[-1] - 0.3 * made[-2] / (1 + x[i] * x[i]))
        return made

    def two_chains(x, p):
        """One that depends on another, with something between that does not depend on itself."""
        first, second = [p], [x[0]]
        for i in range(N):
            first.append(ca.tanh(first[-1] + x[i]))
            between = first[-1] * x[i] + ca.cos(first[-2])
            second.append(second[-1] * 0.5 + between)
        return second

    def backwards(x, p):
        first = [ca.sin(x[i]) * p for i in range(N)]
        return [first[i] * x[N - 1 - i] + 1 for i in reversed(range(N))]

    def far_back(x, p):
        made = [ca.cos(x[i]) for i in range(3)]
        for i in range(3, N):
            made.append(made[i - 3] * p + ca.sin(x[i]) - made[i - 1])
        return made

    def tree(x, p):
        made = [x[0] * p]
        for i in range(1, N):
            made.append(made[(i - 1) // 2] * 0.5 + ca.sin(x[i]) * x[i])
        return made

    def uneven(x, p):
        """Values of passes before, not always as many."""
        made = [p, p + 1, p + 2, p + 3]
        for i in range(4, N):
            made.append(ca.cos(made[-back[i]]) * x[i] + x[i - 1])
        return made

    def nothing_computed(x, p):
        return [x[N - 1 - i] for i in range(N)]

    return {f.__name__: f for f in (each, constants, out_of_line, sums, two_back, two_chains)} | {
        f.__name__: f for f in (backwards, far_back, tree, uneven, nothing_computed)
    }


@pytest.mark.parametrize("shape", shapes())
def test_loops_give_the_bits_of_casadi(host, packed, short, shape):
    x, p = ca.SX.sym("x", N), ca.SX.sym("p")
    results = shapes()[shape](x, p)
    f = ca.Function("f", [x, p], [ca.vertcat(*results), ca.vertcat(*results[::-3], 0.0)])
    assert code(f).looped == (shape not in ("tree", "uneven"))
    check(host, packed, f)


def test_a_pass_takes_no_more_words_for_more_passes(short):
    """Values of each pass alone, of passes before, and of another loop backwards."""
    few, many = (code(chain(length)) for length in (100, 1000))
    assert few.looped
    assert len(many.words) == len(few.words) < 200
    assert len(many.results) == len(few.results)


@pytest.mark.parametrize("seed", DRAWS)
def test_random_loops_give_the_bits_of_casadi(host, packed, short, seed):
    """Random operations on values of the same pass, of passes before, of other loops, on arguments and constants."""
    rng = np.random.default_rng(seed)
    x, p = ca.SX.sym("x", 2 * N), ca.SX.sym("p")
    tables_of: list[list[list]] = []  # of each loop, values by pass
    for _ in range(3):
        size = int(rng.integers(2, 25))
        plan = []
        for k in range(size):
            a, b = (plan_operand(rng, k, len(tables_of)) for _ in range(2))
            plan.append((BINARY[rng.integers(9, 13)], a, b, rng.random() < 0.2))
        rows: list[list] = []
        for i in range(N):
            row: list = []
            for g, a, b, turned in plan:
                left, right = (operand(each, i, row, rows, tables_of, x, p) for each in (a, b))
                made = g(left, right)
                row.append(ca.sin(made) if turned else ca.fmax(ca.fmin(made, 2.0), -2.0))
            rows.append(row)
        tables_of.append(rows)
    results = [value for rows in tables_of for row in rows for value in row[-2:]]
    f = ca.Function("f", [x, p], [ca.vertcat(*results)])
    check(host, packed, f)


def plan_operand(rng: np.random.Generator, k: int, loops: int) -> tuple:
    kind = rng.choice(["own", "before", "x", "p", "constant", "loop"], p=[0.4, 0.2, 0.15, 0.05, 0.1, 0.1])
    if kind == "own" and k:
        return "own", int(rng.integers(k))
    if kind == "before":
        return "before", float(rng.random()), int(rng.integers(1, 3))
    if kind == "constant":
        return "constant", float(rng.uniform(0.5, 2.0)), bool(rng.random() < 0.5)
    if kind == "loop" and loops:
        return "loop", int(rng.integers(loops)), float(rng.random()), bool(rng.random() < 0.5)
    return ("p",) if kind == "p" else ("x", int(rng.integers(1, 3)), int(rng.integers(0, 2)))


def operand(each: tuple, i: int, row: list, rows: list[list], loops: list[list[list]], x: ca.SX, p: ca.SX):
    kind, *rest = each
    if kind == "own":
        return row[rest[0]]
    if kind == "before":
        share, back = rest
        return rows[i - back][int(share * len(rows[i - back]))] if i >= back else x[i]
    if kind == "constant":
        value, differs = rest
        return value + 0.01 * i * i if differs else value
    if kind == "loop":
        which, share, backwards = rest
        found = loops[which][N - 1 - i if backwards else i]
        return found[int(share * len(found))]
    return p if kind == "p" else x[rest[0] * i % (2 * N)] + rest[1]


@pytest.fixture(scope="module", params=["natural", "absolute"])
def chains(request) -> list[Equations]:
    """N-four-bars of 30 and of 60 loops, traced."""
    return [prepared(derived("n_four_bar", loops=n, coordinates=request.param), "vm") for n in (30, 60)]


@pytest.fixture
def looped(monkeypatch) -> None:
    """Functions of 3000 operations are searched for what repeats."""
    monkeypatch.setattr(passes, "LONG", 3000)


@pytest.fixture(scope="module")
def chain_scene(chains) -> bytes:
    """The scene of the shorter chain, with loops in functions of 3000 operations."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(passes, "LONG", 3000)
        return tables.packed(complete(chains[0]))


@pytest.mark.slow
@pytest.mark.usefixtures("looped")
def test_all_functions_of_a_chain_give_the_bits_of_casadi(host, chains, chain_scene):
    loaded = host.load(chain_scene)
    own = complete(chains[0])
    long = [file.code(f, "chain") for f in own.functions.values() if f.n_instructions() > 2 * passes.LONG]
    assert len(long) >= 7
    assert all(each.looped for each in long)
    assert host.count(loaded) == len(own.functions)
    for k, f in enumerate(own.functions.values()):
        x = arguments(f)
        assert same_bits(host.call(loaded, k, f, x), expected(f, x)), f.name()


@pytest.mark.slow
def test_the_functions_of_a_chain_hardly_grow_with_it(chains, short):
    few, many = (complete(e) for e in chains)
    for name in ("weighted_evaluate", "weighted_iterate", "weighted_correct", "seen", "limits"):
        one, two = code(few.functions[name]), code(many.functions[name])
        assert many.functions[name].n_instructions() > 1.9 * few.functions[name].n_instructions()
        assert two.words.size + two.results.size < 1.25 * (one.words.size + one.results.size), name


@pytest.mark.slow
@pytest.mark.parametrize("name", ["five_bar", "bennett", "slider_crank"])
def test_all_functions_of_a_scene_give_the_bits_of_casadi(host, short, name):
    """Also where loops are looked for in all of them."""
    e = prepared(derived(name), "vm")
    loaded = host.load(tables.packed(complete(e)))
    for k, f in enumerate(complete(e).functions.values()):
        x = arguments(f)
        assert same_bits(host.call(loaded, k, f, x), expected(f, x)), f.name()


@pytest.mark.slow
@pytest.mark.usefixtures("looped")
def test_the_same_equations_give_the_same_bytes(chains, chain_scene):
    assert tables.packed(complete(replace(chains[0]))) == chain_scene


# In lanes -------------------------------------------------------------------------------------------------------------

PLACES = 11
"""Calls at once, more than there are lanes, so that some are left."""


def quick_step(small: Equations, packed: Callable, steps: Steps, *functions: ca.Function) -> bytes:
    """A scene with this quick step of these functions."""
    kernel = small.kernel | {"quick": replace(small.kernel["quick"], steps=steps)}
    return packed(*functions, kernel=kernel)[0]


@pytest.mark.parametrize("seed", range(3))
def test_calls_in_lanes_give_the_bits_of_one_after_the_other(host, small, packed, seed):
    rng, z = np.random.default_rng(seed), ca.SX.sym("z", 10)
    f = random_function(rng, (40, 300, 2000)[seed])
    given = [(ca.sin(z[:5] + k), z[5] - k) for k in range(PLACES)]
    begin = ca.Function("begin", [z], [each for pair in given for each in pair])
    calls = tuple(Call(f.name(), (f"x{k}", f"p{k}"), (f"y{k}", f"w{k}")) for k in range(PLACES))
    first = Call("begin", ("z",), tuple(name for call in calls for name in call.arguments))
    memory = np.zeros(Layout(small).size)
    memory[:10] = rng.uniform(0.5, 1.5, 10)
    found = [
        host.run(host.load(quick_step(small, packed, (first, *steps), begin, f)), True, memory)
        for steps in (calls, [Lanes(calls)])
    ]
    assert same_bits(*found)
    assert len(np.unique(found[0])) > 5 * PLACES


# Compiled -------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.usefixtures("quickly_compiled")
@pytest.mark.parametrize(("name", "options"), [("five_bar", {}), ("bennett", {}), ("n_four_bar", {"loops": 8})])
def test_compiled_functions_give_the_bits_of_interpreted_ones(host, name, options):
    e = prepared(derived(name, **options), "vm")
    scene, own = tables.packed(complete(e)), complete(e)
    path = build.compiled_scene(e, scene)
    interpreted, other = host.load(scene), host.load(scene)
    assert not host.replace(other, path, b"another")
    assert not host.replace(other, path, more=-1)
    assert host.replace(other, path)
    for k, f in enumerate(own.functions.values()):
        x = arguments(f)
        found, wanted = (host.call(each, k, f, x) for each in (other, interpreted))
        assert same_bits(found, wanted), f.name()
    instance = alfmu.Instance(e)
    instance.initialize()
    instance.step(max(e.step_size, 0.02))
    memory = instance.memory.block[: Layout(own).size]
    after = Layout(own).fields["after"][0]
    for quick in (True, False):
        found, wanted = (host.run(each, quick, memory) for each in (other, interpreted))
        assert same_bits(found, wanted)
        assert not quick or np.isfinite(found[after : after + 2 * e.n]).all()


def test_a_result_may_be_written_over_an_argument_of_a_compiled_function():
    e = prepared(derived("five_bar"), "vm")
    text = "".join(tables.machine_code(complete(e), tables.packed(complete(e))))
    for name in ("weighted_place", "weighted_return", "dynamics"):
        body = text.split(f"void {name}(Arguments x")[1].split("\n}\n")[0]
        assert "const Real x0_0 = x[0][0];" in body
        assert body.rindex("= x[") < body.index("y[0][0] =")


def test_small_integers_take_one_byte():
    """By hand: twice the number, less one if negative, in base 128."""
    w = Writer()
    w.integers([0, -1, 63, -64, 64, -8192, 8192, 2**31 - 1, -(2**31)])
    count, *numbers = w.parts
    assert count == b"\x09\0\0\0"
    assert b"".join(numbers).hex(" ") == "00 01 7e 7f 81 00 ff 7f 81 80 00 8f ff ff ff 7e 8f ff ff ff 7f"


# Damage ---------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_damage_of_any_byte_is_refused_or_harmless(small, packed, short, tmp_path):
    """Also with a check sum that agrees: every place that a scene names is checked, with loops of all kinds and calls
    in lanes in it."""
    x, p = ca.SX.sym("x", N), ca.SX.sym("p")
    made = [ca.vertcat(*shapes()[name](x, p)[:20]) for name in ("two_chains", "out_of_line")]
    u, p_of = ca.SX.sym("u", 2), ca.SX.sym("p", 3)
    g = ca.Function("g", [u, p_of], [ca.vertcat(ca.sin(u[0]) / p_of[0], ca.fmin(u[1], p_of[1] * p_of[2]))])
    lanes = Lanes(tuple(Call("g", ("u", "p"), (f"y{k}",)) for k in range(3)))
    scene = quick_step(small, packed, (lanes,), ca.Function("f", [x, p], made), g)
    jacobian = Writer()
    jacobian.integer(2)
    for entry in ("x/force.x", "y/force.x"):
        tables._Table._variable(jacobian, Variable(entry, "m/N"))
        jacobian.integer(0)
        jacobian.integer(0)
    whole, scene = len(scene), tables.identified(scene + b"".join(jacobian.parts), "")
    assert len(scene) < 60000
    (tmp_path / "scene.bin").write_bytes(scene)
    checks = ["-fsanitize=address,undefined", "-fno-sanitize-recover=undefined"]
    done = compiled(tmp_path / "host", "-Og", *checks)  # which takes less time than -O1, with its compilation
    if "sanitize" in done.stderr or "cannot find" in done.stderr:
        done = compiled(tmp_path / "host", "-O1")
    assert done.returncode == 0, done.stderr
    command = [str(tmp_path / "host"), str(tmp_path / "scene.bin"), str(whole)]
    said = subprocess.run(command, capture_output=True, text=True, check=False)
    assert said.returncode == 0, said.stdout + said.stderr
    refused, taken = (int(word) for word in said.stdout.split() if word.isdecimal())
    assert refused > 4 * len(scene) > taken > 0


@pytest.mark.parametrize(
    ("at", "value", "reason"),
    [
        (0, b"X", "not a scene file"),
        (8, b"\x7f", f"its version is 127 and this runtime reads {alfmu.kernel.VERSION}; export it again"),
        (12, b"\x00", "bytes instead of"),
        (16, b"\x00", "its check sum does not agree"),
        (70, b"\xff", "its check sum does not agree"),
    ],
)
def test_a_damaged_file_is_refused_with_the_reason(host, packed, at, value, reason):
    scene, _ = packed()
    assert scene[at : at + 1] != value
    with pytest.raises(ValueError, match=reason):
        host.load(scene[:at] + value + scene[at + 1 :])


def test_programs_are_few_and_explained():
    page = (Path(__file__).parents[1] / "docs" / "development.md").read_text()
    explained = re.findall(r"^\| `(\w+)` \| .* \| .* \| [\d,]+", page, flags=re.MULTILINE)
    assert sorted(explained) == sorted(tables.PROGRAMS.values())
    assert len(explained) <= 20
