"""Studies: laws, micro-integration, macro scale and tissue put together to answer one question.

    shear_steps            figure 5: stress over shear steps, every initialisation
    relaxation             figure 6: mean force and error of the state over iterations
    bar_comparison         figure 8: the bending bar against the full tissue
    initialisation_errors  error of each initialisation as the rate goes down
    moduli, moduli_tables  elastic and viscous moduli of a plant cell
    memory                 how long an RVE remembers its past

Each computes plain results and describes them as a `report.study.Study`; files are not its matter.
"""
