"""Runs as functions of JAX and PyTorch: the examples of docs/howto/learning.md."""

import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[1] / "docs" / "learning"


def example(name: str, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    names = runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    assert capsys.readouterr().out.count("\n") == 1
    return names


def differences(function: Any, at: np.ndarray, along: np.ndarray, step: float) -> np.ndarray:
    """The derivative of a function along a direction, by central differences of fourth order."""
    one, two = ((function(at + k * step * along) - function(at - k * step * along)) / (2 * k * step) for k in (1, 2))
    return (4 * one - two) / 3


def test_a_network_in_jax_is_trained_through_runs(capsys):
    jax = pytest.importorskip("jax")
    n = example("network_jax", capsys)
    np.testing.assert_allclose(n["reached"], [n["WANTED"], 0.0], atol=1e-4)
    rng = np.random.default_rng(1)
    torque, along = rng.normal(size=(2, len(n["TIMES"])))
    weights = rng.normal(size=(len(n["TIMES"]), 2))
    _, pull = jax.vjp(n["run"], torque)
    found = float(np.dot(pull(weights)[0], along))
    wanted = (differences(n["simulated"], torque, along, 1e-3) * weights).sum()
    assert abs(found - wanted) < 1e-7 * abs(wanted)


def test_an_optimiser_of_pytorch_finds_parameters_through_runs(capsys):
    torch = pytest.importorskip("torch")
    n = example("parameters_torch", capsys)
    np.testing.assert_allclose(n["found"], n["TRUE"], rtol=1e-4)
    numbers = torch.from_numpy(0.9 * n["TRUE"]).requires_grad_()
    weights = torch.from_numpy(np.random.default_rng(1).normal(size=n["measured"].shape))
    (n["Run"].apply(numbers) * weights).sum().backward()

    def sums(x: np.ndarray) -> float:
        return float((n["Run"].apply(torch.from_numpy(x)) * weights).sum())

    for k, found in enumerate(numbers.grad.tolist()):
        wanted = differences(sums, 0.9 * n["TRUE"], np.eye(2)[k], 1e-3)
        assert abs(found - wanted) < 1e-7 * abs(wanted)
