"""Independent references: closed forms, minimal coordinates, Newton's law, and numerical differentiation.

Nothing here imports alfmu. Each module writes its equations by hand, in another form than alfmu derives them, and
computes them with mpmath or an integrator of order eight, tighter than whatever it judges.
"""
