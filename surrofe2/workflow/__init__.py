"""What the commands do, without a terminal: laws, macro scale and files wired together.

In reading order:

    progress       how work reports what it does
    laws           the stress law of a run: chosen, started from a kept reference, warmed up
    cell_laws      the same of several cell types, each at the points of its regions
    run_outputs    what a run leaves in its folder, by a command or from Python
    run            a bar by a stress law
    tissue         the full microscopic tissue
    surfaces       the law of free sides, kept
    rest           the bar at rest under its load, and its small oscillations
    workers        pieces of work by several processes or a cluster
    generate       a data set of true stresses
    samples        what training takes: the data set's samples and harvests
    train          a surrogate from these
    calibrate      the bound of its error; varied_loads: of the runs it is calibrated along
    refinement     active learning: rounds of cached run, sampling and training
    comparison     runs against each other; report: runs on one page
    zoom           the plant cell at a point of a run; cell_fields: what all points met
    grid           parameter studies; grid_tasks: what their processes are given
    new_recipe     a recipe to start from
    recipe_check   what is wrong with a recipe, before anything is computed
    dry_run        the range that a recipe needs, how long true RVEs take, which law to take
    study          all of a recipe: data set, surrogate, runs and their comparison

Everywhere: what is finished is kept, what was interrupted goes on, `fresh` starts over whatever is
there, and output of other settings is refused with a MismatchError that names the difference.
`report(done, note)` is told how far the work is, `stage(what, total, unit)` begins such a display.
"""
