"""Analyses of a mechanism: equilibria, linearisation, degrees of freedom.

Other rooms import `equilibria`, `freedoms`, `kinematics`, `linearization`, `loops`, `situation`, `start`, `states`.
"""
