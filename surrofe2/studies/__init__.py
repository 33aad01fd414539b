"""Studies: laws, micro-integration, macro scale and tissue put together to answer one question.

    drives           deformations over time that RVEs are driven by
    initialisations  figure 5 over shear steps, and the error of each as the rate goes down
    relaxation       figure 6: mean force and error of the state over iterations
    bar_runs         runs of the bending bar, kept one by one, and what is read off them
    bar_comparison   bars against the full tissue: figure 8, growing bars, damping
    stability        where a plant cell has a stable equilibrium
    moduli           elastic and viscous moduli of a plant cell
    memory           how long an RVE remembers its past

Each computes plain results and describes them as a `report.study.Study`; files are not its matter.
"""
