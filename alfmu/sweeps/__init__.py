"""Many runs of one mechanism or FMU with other numbers each: planned, run on all cores or a cluster, kept in parts.

Other rooms import `sweep`.
"""
