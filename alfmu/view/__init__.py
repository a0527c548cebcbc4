"""Drawings and films of mechanisms, diagrams of results.

Other rooms import `drawing`, `eigenvalues`, `fitted`, `live`, `picture`, `plot`, `shapes`.
"""
