"""The paper's equations, singular positions, integrators, implicit rules: for arrays and symbols alike."""
