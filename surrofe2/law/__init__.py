"""The hinge between the scales: code that needs stresses knows nothing of a law but this.

In reading order:

    stress_law    respond(F, F_dot) -> StressResponse, accept(F, F_dot, response)
    surface_law   its like for free sides: stretch and rate in, line tension out
    bifurcation   which points of a law are beyond one
    ahead         laws that learn where a step is about to go
    regional_law  several plant cells as one law
    samples       (F, Ḟ) and the stresses that a law answered, the data of a surrogate
    paths         a law along a path of (F, Ḟ)
"""
