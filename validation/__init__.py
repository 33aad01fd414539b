"""What validates the package: the paper's figures, and studies beyond them. Not in the wheel.

`python -m validation` lists the studies, and `python -m validation NAME` runs one of them.

    case           a run of a problem by a method, its kept curve, its distance from the tissue;
                   what a study is given
    damped_fit     period and decrement of a curve
    rve            fig5, fig6, rates: initialisations of an RVE against its integration in time
    bars           fig8, scales: bending bars by FE² against the full tissue
    tissues        problems, thin: other problems; thin tissue with the law of its free sides
    ablation       what each part of the surrogate is worth, beside other regressions
    arrangements   irregular plant cells: equilibria of their fluid, and Cauchy–Born
    worst_answer   the worst states that a search finds among those that the cache accepts
"""
