"""Programs of a scene as steps: the ways through them."""

from alfmu.kernel.form import Call, Choice, Factor, Loop, Program, Solve, called, every, rewritten, taken

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
