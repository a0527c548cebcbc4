"""
PyTorch finds the masses of a slider-crank
==========================================

A run of a mechanism as a function in PyTorch: its derivative backward is alfmu's adjoint, so that modules and
optimisers of PyTorch work with it. Here an optimiser finds two masses from a motion under a known torque. To run it,
`pip install torch`, then `python docs/learning/parameters_torch.py`.
"""

import numpy as np
import torch

import alfmu
from alfmu.gradients import Function

torch.set_default_dtype(torch.float64)

OUTPUTS = "crank.angle", "slider.x"
UNKNOWN = "m2", "m3"  # of the rod and the slider
TRUE = np.array([0.7, 1.3])  # kg
HOW = {"communication_step": 0.01, "stop_time": 1.0, "inputs": {"A.torque": 8.0}}


def given(masses: np.ndarray) -> dict[str, float]:
    return dict(zip(UNKNOWN, map(float, masses), strict=True))


# %%
# The run: masses in, outputs at all communication points out.


class Weighted(Function):
    """The sum of outputs times weights, which PyTorch asks the derivative of."""

    names = OUTPUTS

    def __init__(self, weights: np.ndarray):
        self.weights = weights

    def weighed(self, times: np.ndarray, columns: np.ndarray) -> tuple[float, np.ndarray]:
        return float((self.weights * columns).sum()), self.weights


class Run(torch.autograd.Function):
    @staticmethod
    def forward(ctx, masses: torch.Tensor) -> torch.Tensor:
        ctx.save_for_backward(masses)
        result = alfmu.simulate("slider_crank", outputs=OUTPUTS, parameters=given(masses.detach().numpy()), **HOW)
        return torch.from_numpy(np.stack([result[name] for name in OUTPUTS], axis=1))

    @staticmethod
    def backward(ctx, weights: torch.Tensor) -> torch.Tensor:
        (masses,) = ctx.saved_tensors
        found = alfmu.gradient(
            "slider_crank", Weighted(weights.numpy()), UNKNOWN, parameters=given(masses.numpy()), **HOW
        )
        return torch.tensor([found[name] for name in UNKNOWN])


# %%
# A measured motion, and the search.

measured = Run.apply(torch.from_numpy(TRUE))
size = measured.std(dim=0)
logarithms = torch.zeros(2, requires_grad=True)  # so that masses stay positive
search = torch.optim.LBFGS([logarithms], max_iter=60, tolerance_grad=1e-10, line_search_fn="strong_wolfe")


def misfit() -> torch.Tensor:
    search.zero_grad()
    away = (((Run.apply(logarithms.exp()) - measured) / size) ** 2).mean()
    away.backward()
    return away


search.step(misfit)
found = logarithms.exp().detach().numpy()
print(", ".join(f"{name} {value:.5f} kg (true {true})" for name, value, true in zip(UNKNOWN, found, TRUE, strict=True)))
