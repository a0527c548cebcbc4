"""Analyses of a mechanism: positions of rest, small motions about a state, degrees of freedom.

Other rooms import `equilibria`, `freedoms`, `linearization`, `start`, `states`.
"""
