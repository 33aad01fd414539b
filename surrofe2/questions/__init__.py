"""Questions about a plant cell, such as its moduli; each module computes the answer to one.

    moduli           what experiments find at rest: moduli, turgor
    wilting          size and moduli against turgor in a bath
    memory           how long an RVE remembers its past
    stability        where a plant cell has a stable equilibrium
    cell_image       cells of a labelled image, an RVE that is like them

Each computes plain results; `wilting`, `memory` and `stability` describe theirs as a
`report.study.Study`.
"""
