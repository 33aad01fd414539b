"""An in-situ adaptive table of RVE answers (ISAT) that grows as it is used.

In reading order: `records` are linear models with ellipsoids of accuracy, which RVE answers grow
and shrink, `lookup` finds those that hold a point and evaluates them, `stress_table` is the law and
what learns.
"""
