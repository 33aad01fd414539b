"""surrofe2 in other programs; each module is for one of them and imports none of it.

felupe    a stress law as the material of a FElupe solid body
"""
