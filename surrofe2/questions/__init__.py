"""Questions about a plant cell, each with its answer.

    moduli           elastic and viscous moduli at rest
    memory           how long an RVE remembers its past
    stability        where a plant cell has a stable equilibrium

Each computes plain results; `memory` and `stability` describe theirs as a `report.study.Study`.
"""
