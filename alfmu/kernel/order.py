"""The operations of a function in an order that CasADi's virtual machine runs faster.

The virtual machine looks at each operation to see what to do, and a processor that cannot foresee it loses as much time
there as with the operation itself. Equal operations one after another are foreseen.
"""

from __future__ import annotations

from collections import defaultdict
from itertools import chain

import casadi as ca

from .stream import Instructions

__all__ = ["in_runs", "runs"]


def in_runs(f: ca.Function) -> ca.Function:
    """The same function, which calls no other, with equal operations in runs.

    CasADi computes what a call takes in the order of its arguments. So the function becomes a call that takes its
    values in the order of the runs, and gives back those that are results.
    """
    instructions = Instructions.of(f)
    taken = list(chain(*runs(instructions)))
    place = {k: i for i, k in enumerate(taken)}
    known = ca.SX.sym("known", len(taken))
    results = [ca.SX.zeros(f.sparsity_out(i)) for i in range(f.n_out())]
    for k, operation in enumerate(instructions.code.tolist()):
        if operation == ca.OP_OUTPUT:
            which, entry = instructions.place[:, k]
            results[which].nz[entry] = known[place[instructions.operands[0, k]]]
    together = ca.Function("together", [known], results)
    arguments, values = f.sx_in(), f.instructions_sx()
    for k in (instructions.code == ca.OP_INPUT).nonzero()[0].tolist():
        which, entry = instructions.place[:, k].tolist()
        values[k] = arguments[which].nz[entry]
    return ca.Function(f.name(), arguments, together.call([values[taken]], False, True))


def runs(instructions: Instructions) -> list[list[int]]:
    """What the instructions compute, in runs of equal operations."""
    code, operands = instructions.code.tolist(), instructions.operands.T.tolist()
    users: list[list[int]] = [[] for _ in code]
    missing = [0] * len(code)
    ready: dict[int, list[int]] = defaultdict(list)
    for k, made in enumerate(operands):
        if code[k] == ca.OP_OUTPUT:
            continue
        for i in made:
            if i >= 0:
                users[i].append(k)
                missing[k] += 1
        if not missing[k]:
            ready[code[k]].append(k)
    runs = []
    while any(ready.values()):
        waiting = ready[max(ready, key=lambda operation: len(ready[operation]))]
        runs.append(run := [])
        while waiting:
            run.append(k := waiting.pop())
            for user in users[k]:
                missing[user] -= 1
                if not missing[user]:
                    ready[code[user]].append(user)
    return runs
