"""An in-situ adaptive table of RVE answers (ISAT) that grows as it is used.

In reading order: `records` are linear models with ellipsoids of accuracy, `ellipsoids` grows and
shrinks them by RVE answers, `screen` finds those that hold a point, `lookup` evaluates them,
`stress_table` is the law and what learns.
"""
