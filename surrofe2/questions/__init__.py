"""Questions about a plant cell, each with its answer.

    moduli           what experiments find at rest: moduli, turgor
    wilting          size and moduli against turgor in a bath
    memory           how long an RVE remembers its past
    stability        where a plant cell has a stable equilibrium
    cell_image       cells of a labelled image, an RVE that is like them

Each computes plain results; `wilting`, `memory` and `stability` describe theirs as a
`report.study.Study`.
"""
