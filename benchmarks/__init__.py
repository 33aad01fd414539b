"""How fast surrofe2 is, beside plain variants and the paper's scheme: `python -m benchmarks`.

One module an item of what must hold; each has a TITLE and `run(setting) -> list[Row]`:

    force_evaluation   lanes against a scalar loop and the numpy twin
    rve_solve          Jacobian, warm and cold solves, stability
    initialisations    slow manifold and tangents beside constrained runs
    paper_scheme       `direct` against the paper's iteration
    bar                the bending bar by true and by cached FE²
    tissue             the bar by FE² against the full tissue
    trust              the cache's error against its tolerance
    macro_overhead     a right-hand side but for its stress law
    inference          the cached law against torch
    data_set           samples a second
    start_up           help, compilation, memory
    commands           whole processes by true and by cached FE², and their start
    linear_cost        cost over the number of points, and its plot

`row` says what a figure is, `timing` how it is taken, `setting` on what; `report` writes them.
Comparisons are timed side by side, A B A B, in one process after compilation.
"""
