"""surrofe2 in other programs, each of which has a module of its own here.

felupe         a stress law as the material of a FElupe solid body
micro_manager  RVEs and surrogate as micro simulations of preCICE's Micro Manager, the latter by
               micro_manager_surrogate
"""
