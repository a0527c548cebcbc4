"""The kernel: the method traced over a mechanism's equations into flat functions, and the ways to run them."""

__all__ = ["DEFAULT", "KERNELS"]

KERNELS = {
    "vm": "the method traced into one function for the scene, run by CasADi's virtual machine",
    "oracle": "the method on NumPy arrays with loops that stop on convergence: slow, for comparison",
}
"""Ways to run a mechanism."""

DEFAULT = "vm"
