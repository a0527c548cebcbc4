"""Parameter studies: many runs of one mechanism or FMU, planned, run on all cores or a cluster, stored in parts.

Other rooms import `sweep`.
"""
