"""Programs of a scene as steps: the ways through them."""

from alfmu.kernel.form import (
    Call,
    Choice,
    Factor,
    Lanes,
    Loop,
    Program,
    Solve,
    called,
    every,
    lifetimes,
    renamed,
    rewritten,
    taken,
)
from alfmu.kernel.lanes import laned

FIRST, INNER = Call("f", ("a",), ("b",)), Call("g", ("b", "c"), ("d",))
STEPS = FIRST, Choice("near", (INNER,)), Loop("more", "most", (INNER, Choice("far", zero=(INNER,))))


def test_every_step_is_found_inside_choices_and_loops():
    assert list(called(Program(STEPS))) == ["f", "g", "g", "g"]
    assert [type(step) for step in every(STEPS)] == [Call, Choice, Call, Loop, Call, Choice, Call]


def test_what_has_to_be_known_before():
    """What a choice or a loop may leave as it is has to be known; what a call gives need not be."""
    assert set(taken(STEPS, ["b", "d", "e"])) == {"a", "near", "c", "more", "most", "far", "d", "e"}
    assert set(taken([Factor(("w", "H"), ("F", "o"), 2, 1), Solve(("F", "o", "r"), ("x",), 2, 1)], ["x"])) == {
        *("w", "H", "r")
    }


def test_values_of_a_loop_live_as_long_as_the_loop():
    """Steps by number: a call 0, a choice 1 with a call 2, and a loop 3 with steps up to 6."""
    begun = {"a": (0, 0), "b": (0, 6), "near": (1, 1), "c": (2, 6), "d": (2, 6)}
    assert lifetimes(STEPS) == begun | dict.fromkeys(("more", "most", "far"), (3, 6))


def test_steps_are_rewritten_inside_choices_and_loops():
    def twice(step):
        return [step] * (2 if step == INNER else 1)

    found = rewritten(STEPS, twice)
    assert found == (
        FIRST,
        Choice("near", (INNER, INNER)),
        Loop("more", "most", (INNER, INNER, Choice("far", zero=(INNER, INNER)))),
    )
    assert rewritten(STEPS, lambda step: [step]) == STEPS


def test_calls_in_lanes_are_calls():
    lanes = Lanes((FIRST, Call("f", ("c",), ("d",))))
    assert list(called(Program((lanes,)))) == ["f", "f"]
    assert taken([lanes], ["b", "d", "e"]) == ["e", "a", "c"]
    assert rewritten([lanes], lambda call: [call, INNER]) == (lanes, Lanes((INNER, INNER)))


def test_names_change_everywhere():
    new = {"b": "B", "near": "N", "most": "M"}
    first, choice, loop = renamed((Lanes((FIRST,)), *STEPS[1:]), new)
    assert first == Lanes((Call("f", ("a",), ("B",)),))
    assert choice == Choice("N", (Call("g", ("B", "c"), ("d",)),))
    assert (loop.number, loop.most, loop.body[0].arguments) == ("more", "M", ("B", "c"))


def place(k: int) -> tuple:
    """What a program does at a place: values of one name that each place keeps for itself, and a result of its own."""
    return (
        Call("begin", (f"place{k}", "p"), ("near",)),
        Choice("near", (Call("more", ("near",), ("near",)),)),
        Call("end", ("near", "p"), (f"found{k}",)),
    )


def test_what_repeats_on_other_values_is_done_side_by_side():
    after = Call("sum", tuple(f"found{k}" for k in range(6)), ("all",))
    first, *choices, last, end = laned(Program((*(step for k in range(6) for step in place(k)), after)), {"all"}).steps
    assert [type(step) for step in (first, *choices, last)] == [Lanes, *[Choice] * 6, Lanes]
    own = [call.results[0] for call in first.calls]
    assert len(set(own)) == 6
    assert [choice.number for choice in choices] == own
    assert [call.arguments[0] for call in last.calls] == own
    assert end == after
    assert [call.results[0] for call in last.calls] == [*after.arguments]


def test_what_goes_on_from_each_other_is_done_in_turn():
    """Also where the last of what all give is known later."""
    chain = Program(tuple(Call("f", ("a",), ("a",)) for _ in range(6)))
    assert laned(chain, {"a"}) == chain
    same = Program(tuple(Call("f", (f"a{k}",), ("b",)) for k in range(6)))
    assert laned(same, {"b"}) == same
    few = Program(tuple(step for k in range(3) for step in place(k)))
    assert laned(few, {f"found{k}" for k in range(3)}) == few
