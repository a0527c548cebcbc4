"""The paper's equations, singular positions, integrators, implicit rules: for arrays and symbols alike.

Other rooms import `formulations`, `friction`, `implicit`, `inputs`, `integrators`, `singular`, `stepping`.
"""
