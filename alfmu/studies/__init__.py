"""Studies with a judgement of accuracy: reports, maps of stability, the paper's study, other codes, costs of steps.

Other rooms import `about`, `page`, `plots`, `report`, `stability`.
"""
