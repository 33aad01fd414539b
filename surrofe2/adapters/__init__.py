"""surrofe2 in other programs, each of which has a module of its own here.

felupe        a stress law as the material of a FElupe solid body
scikit_learn  a surrogate as a regressor
"""
