"""The kernel: the method traced over a mechanism's equations into flat functions and programs.

Other rooms import `alternatives`, `arrangement`, `complete`, `controlled`, `exchange`, `form`, `joined`, `kinks`,
`memory`, `shorten`, `stream`, `symbolic`, `tables`, `thresholds`, `trace`.
"""

__all__ = ["DEFAULT", "KERNELS", "VERSION"]

KERNELS = {
    "vm": "the method traced into functions for the scene, run by the interpreter of alfmu's runtime",
    "compiled": "the same functions as C, compiled by the system's compiler or by ziglang",
    "auto": "compiled if there is a compiler, otherwise vm",
    "oracle": "the method on NumPy arrays with loops that stop on convergence: slow, for comparison",
}
"""Ways to run a mechanism."""

DEFAULT = "vm"

VERSION = 33
"""Version of scene files, increased whenever their content changes meaning."""
