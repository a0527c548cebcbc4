"""Drawings and films of mechanisms, diagrams of results."""
