"""Parts that every run over time shares, on finite elements and in the full tissue.

Reading order: displacement_curve (and differences of two), charts (panels of curves in one
style), responses (forces over displacements), views (what notebooks and other libraries get of a
result), journal (what a run records, and carries on from), loop (steps with progress, checkpoints
and interrupts).
"""
