"""Checks of any FMU: static checks, records of runs, and calls of a running FMU.

Users call `validation.validate`. `unit` makes the calls of FMI 2 and 3; `calls`, `values` and `motion` contain the
checks; `child` runs them in its own process, as an FMU is native code. Modules that this process needs import neither
CasADi nor the rest of alfmu.
"""
