"""An in-situ adaptive table of RVE answers (ISAT) that grows as it is used.

In reading order: `records` are linear models with ellipsoids of accuracy, `ellipsoids` grows and
shrinks them by true answers, `search_tree` and, while there are few, `screen` find those that hold
a point, `lookup` evaluates them, `stress_table` is the law and what learns.
"""
