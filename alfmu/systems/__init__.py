"""Systems of connected mechanisms, parts and FMUs: described in a file, run, exchanged as SSP, and compared with one
equivalent mechanism.

Other rooms import `coupling`, `masters`, `ssp`, `system`.
"""
