"""What every run over time shares, on finite elements and in the full tissue.

Reading order: journal (what a run records, and carries on from), loop (steps with progress,
checkpoints and interrupts).
"""
