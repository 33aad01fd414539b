"""The work of the commands, without a terminal: laws, macro scale and files wired together.

In reading order:

    laws         the stress law of a run, of one cell type or several, and that of free sides
    inputs       the files from which a run can be repeated
    run          a problem by a stress law, and what it leaves in its folder
    tissue       the full microscopic tissue
    rest         the tissue at rest under its load, and its small oscillations
    repeat       a run repeated from its folder, and compared
    workers      pieces of work by several processes or a cluster
    generate     a data set of RVE stresses, and what training takes of it and of harvests
    train        a surrogate, and the bound of its error, along walks and runs under other loads
    refine       active learning: rounds of cached run, sampling and training
    zoom         the plant cells of a run: at a point, and what all of them met
    grid         parameter studies
    time_scales  whether the loads of a problem are slow
    check        faults of a recipe, the range it needs, how long it takes, which law to take
    scale        how large elements are against plant cells, and what all particles would take

Everywhere: what is finished is kept, what was interrupted is resumed, `fresh` starts over whatever
is there, and output of other settings is refused with a MismatchError that names the difference.
`report(done, note)` is called with how far the work is, `stage(what, total, unit)` begins such a
display.
"""
