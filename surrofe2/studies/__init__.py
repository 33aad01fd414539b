"""Studies: laws, micro-integration, macro scale and tissue put together to answer one question.

    drives                 deformations over time that RVEs are driven by
    shear_steps            figure 5: stress over shear steps, every initialisation
    relaxation             figure 6: mean force and error of the state over iterations
    initialisation_errors  error of each initialisation as the rate goes down
    bar_runs               runs of the bending bar, kept one by one, and what is read off them
    bar_comparison         figure 8: the bending bar against the full tissue
    damping                decrements over mesh, tolerances, micro step and ways to fit
    scale_separation       FE² against tissues of growing size
    stability              where a plant cell has a stable equilibrium
    moduli                 elastic and viscous moduli of a plant cell
    memory                 how long an RVE remembers its past

Each computes plain results and describes them as a `report.study.Study`; files are not its matter.
"""
