"""Judged runs of a mechanism: reports, maps of stability, the paper's study, other codes, what a step costs.

Other rooms import `about`, `page`, `plots`, `report`, `stability`.
"""
