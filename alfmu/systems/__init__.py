"""Connected systems: mechanisms, parts and FMUs whose outputs are inputs of others, described in a file, run, exchanged
as SSP, and compared with one mechanism that has them all.

Other rooms import `coupling`, `masters`, `ssp`, `system`.
"""
