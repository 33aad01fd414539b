"""An in-situ adaptive table of RVE answers (ISAT).

`records` are linear models with ellipsoids of accuracy, `lookup` evaluates them, `slopes` gives the
tangents of that, and `stress_table` is the table, which learns.
"""
