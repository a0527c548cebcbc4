"""Checks of any FMU: what a checker of files sees, records of runs, and calls that only a running FMU can answer.

`validation.validate` is what users call. `unit` makes the calls of FMI 2 and 3; `calls`, `values` and `motion` hold the
checks; `child` runs them in a process of its own, as an FMU is native code. Modules that this process needs import
neither CasADi nor the rest of alfmu.
"""
